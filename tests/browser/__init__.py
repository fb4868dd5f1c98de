"""Tests of `stereogs.verbs.view` and of reports in a browser, which import its modules."""
