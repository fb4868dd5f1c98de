"""Where the data of an opened run is, and what stands for photographs that are not at hand."""
