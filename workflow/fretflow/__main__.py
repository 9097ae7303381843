"""``python -m fretflow`` does what the program ``fretflow`` does."""

from fretflow.cli import main

if __name__ == "__main__":
    main()
