"""HTML pages from the Jinja2 templates in `validation/templates/`, with autoescape."""

import base64
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

FOLDER = Path(__file__).parent / "templates"


def render_page(template: str, **values: Any) -> str:
    """One self-contained page; raises UndefinedError for a value that the template uses and is not given."""
    return _environment().get_template(template).render(values)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=FileSystemLoader(FOLDER),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["base64"] = lambda data: base64.b64encode(data).decode()
    environment.filters["number"] = lambda pair: (str(pair[0]).replace("_", " "), f"{pair[1]:.4g}")
    environment.filters["words"] = lambda key: str(key).replace("_", " ")
    return environment
