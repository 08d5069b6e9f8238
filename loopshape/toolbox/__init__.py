"""What stands beside the bench: each folder a vertical slice with its nouns, verbs, files, pictures and commands.

The bench (core, data, identify, loop, design, io, view, verbs, cli) imports none of them.
"""
