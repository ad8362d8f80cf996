"""Linear laws of the literature, each a structure of one axis whose gains are searched at a price."""
