"""Render results as text, figures and pages."""
