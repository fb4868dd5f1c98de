"""Building blocks for plugins: photographs, networks, views, drawing, web pages, cache."""
