"""Tests of `stereogs.nerfbaselines`, which import its modules."""
