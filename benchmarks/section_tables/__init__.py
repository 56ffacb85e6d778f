"""The tables of `benchmarks/sections.py`, a module each."""
