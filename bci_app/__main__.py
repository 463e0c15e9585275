"""Where ``bci-app`` and ``python -m bci_app`` begin."""

import sys

from bci_app.errors import INTERRUPTED


def main() -> None:
    """Run bci-app. Ctrl-C ends it in a word from the first moment on: loading all that it needs takes a second."""
    try:
        from bci_app.cli import main as run

        run()
    except KeyboardInterrupt:
        sys.stderr.write("Interrupted.\n")
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
