"""Render flights and campaigns as one offline HTML page."""
