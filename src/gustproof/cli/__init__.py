"""The command line: one file a subcommand, which parses, calls and prints.

Modules here import nothing heavy at their top; `gustproof --help` answers at once.
"""
