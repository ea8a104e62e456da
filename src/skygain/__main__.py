"""``python -m skygain`` is the command ``skygain``."""

from __future__ import annotations

from skygain.app.cli import main

if __name__ == "__main__":
    main()
