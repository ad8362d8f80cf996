"""Check certificates in exact arithmetic; nothing of the project is imported here."""
