"""What components return and what loaders load, held to the contract."""
