"""Words for people: the nearest name to a misspelt one, and what a terminal may be shown."""
