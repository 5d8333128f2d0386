"""Templates of the HTML pages that commands write."""

import jinja2


def templates(package: str) -> jinja2.Environment:
    """Return the templates of a package; what they show is escaped, and a name that is not given is an error."""
    return jinja2.Environment(
        loader=jinja2.PackageLoader(package, 'templates'),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
