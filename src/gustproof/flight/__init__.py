"""Fly laws and controllers: endpoints, routes, recordings, scores."""
