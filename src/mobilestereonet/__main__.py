"""``python -m mobilestereonet`` is ``msnet``."""

from mobilestereonet.cli.main import main

if __name__ == "__main__":
    main()
