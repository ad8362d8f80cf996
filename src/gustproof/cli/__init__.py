"""Command line: one module for each subcommand, which parses, calls and prints.

Modules here import nothing heavy at their top, so that `gustproof --help` answers at once.
"""
