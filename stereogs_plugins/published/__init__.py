"""Tables of papers, as data for `stereogs compare --paper`."""
