"""What a flight leaves behind for other programs: bags made from the journal."""
