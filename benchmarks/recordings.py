"""Location of recordings: the folder that HEADLAND_DATA names, else ../shared/data beside the repository."""

import os
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
DATA = Path(os.environ.get("HEADLAND_DATA", ROOT.parent / "shared" / "data"))
