"""`python -m nmes`: the command `nmes`, where its own file is not on the path."""

from nmes.cli import main

if __name__ == "__main__":
    main(prog_name="nmes")
