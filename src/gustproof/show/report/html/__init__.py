"""Flights and campaigns as one offline HTML page."""
