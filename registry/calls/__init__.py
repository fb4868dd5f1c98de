"""Around every call into a plugin: how long it takes, and what it must leave as it was."""
