"""What came of it: scores, tables, plots and a page."""
