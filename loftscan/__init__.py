"""The doors of loftscan: what a person types and what a script imports."""
