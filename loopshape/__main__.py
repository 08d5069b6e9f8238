"""`python -m loopshape`: the program."""

from loopshape.cli import script

if __name__ == "__main__":
    script()
