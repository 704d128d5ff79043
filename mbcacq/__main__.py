"""``python -m mbcacq``: the command."""

from mbcacq.cli import main

if __name__ == "__main__":
    main()
