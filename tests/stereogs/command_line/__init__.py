"""Tests of `stereogs.command_line`, which import its modules."""
