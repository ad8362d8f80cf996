"""Examples of a user's controller: published laws that are no linear law file, one a file, to copy and change."""
