"""Where cameras stand, from pictures of a printed board."""
