"""Health check of the container: exit code 0 when the service answers that it is alive, 1 with the reason otherwise."""

import os
import sys
import urllib.error
import urllib.request

URL = os.environ.get("FUSELOG_PROBE_URL", "http://127.0.0.1:8080/health/live")


def main() -> int:
    """Ask once."""
    try:
        with urllib.request.urlopen(URL, timeout=2) as answer:
            print(answer.read(4096).decode(errors="replace"))
    except (urllib.error.URLError, OSError, ValueError) as error:
        print(f"{URL}: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
