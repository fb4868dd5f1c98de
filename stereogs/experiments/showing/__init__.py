"""Present results: scores, tables, plots and a page."""
