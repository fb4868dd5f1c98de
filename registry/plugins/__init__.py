"""Which plugins there are: found through entry points, recognized by a folder, begun from templates."""
