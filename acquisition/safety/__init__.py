"""What keeps people and the station safe: the guard process, the lease, the states and their table.

`guard` is run by its file's path and imports nothing of ours; `guarding` is the owner's end of it.
"""
