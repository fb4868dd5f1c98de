"""Base classes and data types of plugins; `registry` exports them."""
