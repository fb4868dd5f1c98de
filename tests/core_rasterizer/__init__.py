"""Tests of `core_rasterizer`, which import its modules."""
