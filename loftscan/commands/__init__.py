"""One module a family of commands: what a person types, turned into a verb and said in words."""
