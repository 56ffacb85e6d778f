"""Slices of points in, a watertight surface out. Pure: arrays in, arrays out."""
