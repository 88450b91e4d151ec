"""`python -m spikedeploy` is the command line."""

from spikedeploy.cli import main

if __name__ == "__main__":
    main()
