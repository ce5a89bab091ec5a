"""Configuration of Sphinx, for `make docs`."""

import csv
import inspect
import itertools
import json
import math
import os
import re
from pathlib import Path

from docutils import nodes
from myst_parser.parsers.sphinx_ import MystParser

import fbl_gym
from benchmarks.cli import COMMANDS, prepare
from benchmarks.cli.list import options
from fbl_gym import TwoLinkArmEnv, TwoLinkArmTrackingEnv, __version__
from fbl_gym.records.record import Record


def options_page() -> str:
    """Return the page of options, in Markdown."""
    text = """# All options

`gym.make` and `Scenario` take each option as a record or as plain data: `friction={"viscous": 1.0}`. The field
`disturbance[sine].amplitude` is given by `disturbance={"kind": "sine", "amplitude": 10.0}`. One number for a field
of two numbers is the value of both joints.

`fbl-gym list options` prints this list, and `make docs` writes this page.
"""
    for option, fields in itertools.groupby(options(), lambda field: re.split(r"[.\[]", field.path)[0]):
        text += f"\n## `{option}`\n\n| field | valid values | unit | default | meaning |\n|---|---|---|---|---|\n"
        for field in fields:
            cells = (f"`{field.path}`", field.form, field.unit, field.default, field.meaning)
            text += "| " + " | ".join(cell.replace("|", "\\|").replace("*", "\\*") for cell in cells) + " |\n"
    return text


OPTIONS = Path(__file__).parent / "reference" / "options.md"
if OPTIONS.read_text(encoding="utf-8") != options_page():
    OPTIONS.write_text(options_page(), encoding="utf-8")

PUBLIC = {
    "benchmarks.run.evaluation": "",
    "fbl_gym.model.arm": "",
    "fbl_gym.interface": ":exclude-members: Constraints, Limits",
    "fbl_gym.kernel.batch": ":members: Truth",
    "fbl_gym.envs.error_scales": "",
    "fbl_gym.envs.side_by_side": "",
    "fbl_gym.scenarios": ":members: families, names, get, as_scenario, conditions, in_tier, in_world, member, "
    "held_out_reason\n   :exclude-members: Scenario",
    "controllers.base": ":exclude-members: State",
    "controllers.registry": "",
    "controllers.runner": "",
    "controllers.name": "",
    "controllers.numerics.dynamics": "",
    "controllers.preview": ":exclude-members: Places",
    "controllers.paper.kalman": "",
    "controllers.paper.estimator": "",
    "controllers.paper.gain_scheduling": "",
    "benchmarks.run.rollout": "",
    "benchmarks.run.metrics": "",
    "benchmarks.run.suite": "",
    "benchmarks.run.expansion": "",
    "benchmarks.run.store": "",
    "benchmarks.run.cell": "",
    "benchmarks.run.runner": "",
    "benchmarks.run.traces": "",
    "benchmarks.analysis.statistics": "",
    "benchmarks.analysis.board": "",
    "benchmarks.policies.spec": "",
    "benchmarks.policies.key": "",
    "benchmarks.policies.loading": "",
    "benchmarks.policies.watch": "",
    "benchmarks.run.contract": "",
    "benchmarks.analysis.transfer": "",
    "benchmarks.report.columns": "",
    "benchmarks.tuning.search": "",
}
"""The public modules, each with its options of `automodule`."""

API = Path(__file__).parent / "reference" / "api"
API.mkdir(exist_ok=True)
for module, chosen in PUBLIC.items():
    page = f"{module}\n{'=' * len(module)}\n\n.. automodule:: {module}\n   {chosen}\n"
    if not (file := API / f"{module}.rst").exists() or file.read_text(encoding="utf-8") != page:
        file.write_text(page, encoding="utf-8")


#: The records of the options; those of a scenario and of an arm are elsewhere.
RECORDS = [
    name
    for name, thing in inspect.getmembers(fbl_gym, inspect.isclass)
    if name in fbl_gym.__all__ and issubclass(thing, Record) and name not in ("ArmParameters", "Scenario")
]


def without_mail(_app, doctree) -> None:
    """Turn `LAW@tuned`, which docutils takes for an address of mail, into text again."""
    for link in list(doctree.findall(nodes.reference)):
        if link.get("refuri", "").startswith("mailto:"):
            link.replace_self(link.children)


def with_dark_pictures(app, doctree) -> None:
    """Show a picture's dark form on dark pages, where there is one: arm-dark.gif for arm.gif."""
    for image in [image for image in doctree.findall(nodes.image) if ":" not in image["uri"]]:
        dark = Path(image["uri"]).with_stem(f"{Path(image['uri']).stem}-dark")
        if (Path(app.env.doc2path(app.env.docname)).parent / dark).exists():
            image.parent.insert(image.parent.index(image) + 1, other := image.copy())
            other["uri"] = dark.as_posix()
            image["classes"], other["classes"] = ["only-light"], ["only-dark"]


def with_csv(app, doctree, page) -> None:
    """Write each table of ten columns or more as CSV, and link it below the table."""
    for number, table in enumerate(doctree.findall(nodes.table), 1):
        rows = [[cell.astext() for cell in row.findall(nodes.entry)] for row in table.findall(nodes.row)]
        if app.builder.name == "html" and len(rows[0]) >= 10:
            path = f"tables/{page.replace('/', '-')}-{number}.csv"
            (file := Path(app.outdir) / path).parent.mkdir(exist_ok=True)
            with file.open("w", encoding="utf-8", newline="") as opened:
                csv.writer(opened, lineterminator="\n").writerows(rows)
            link = nodes.reference("", "This table as CSV", refuri="../" * page.count("/") + path)
            table.parent.insert(table.parent.index(table) + 1, nodes.paragraph("", "", link))


def with_shades(_app, doctree, page) -> None:
    """Shade the boards' errors of each family, by how often they double their column's least."""
    for table in doctree.findall(nodes.table):
        head, *rows = [list(row.findall(nodes.entry)) for row in table.findall(nodes.row)]
        titles = [cell.astext() for cell in head]
        if page == "results/board" and "mrad" in titles:
            for column in range(titles.index("mrad") + 1, titles.index("access")):
                cells = [row[column] for row in rows if re.fullmatch(r"[\d.]+", row[column].astext())]
                least = min(float(cell.astext()) for cell in cells)
                for cell in cells:
                    cell["classes"].append(f"shade-{min(int(math.log2(float(cell.astext()) / least)), 5)}")
            about = "The columns of families are errors in %, shaded from 2, 4, 8, 16 and 32 times the least of a column on."
            table.parent.insert(table.parent.index(table) + 1, nodes.paragraph("", about))


class NotebookParser(MystParser):
    """Reads a notebook as Markdown: its cells with their printed lines and their figures."""

    supported = ("notebook",)

    def parse(self, inputstring, document) -> None:
        """Turn the cells into Markdown and parse that."""
        text = ""
        for cell in json.loads(inputstring)["cells"]:
            source = "".join(cell["source"])
            text += f"\n{source}\n" if cell["cell_type"] == "markdown" else f"\n```python\n{source}\n```\n"
            outputs = cell.get("outputs", ())
            if printed := "".join(line for output in outputs for line in output.get("text", ())):
                text += f"\n```text\n{printed}\n```\n"
            for output in outputs:
                if figure := output.get("data", {}).get("image/png"):
                    text += f"\n![Figure of the cell above](data:image/png;base64,{''.join(figure).strip()})\n"
        super().parse(text, document)


def setup(app) -> None:
    """Add the steps above to the build."""
    app.connect("doctree-read", without_mail)
    app.connect("doctree-read", with_dark_pictures, priority=0)  # before pictures are collected
    app.connect("doctree-resolved", with_csv)
    app.connect("doctree-resolved", with_shades)
    app.add_source_suffix(".ipynb", "notebook")
    app.add_source_parser(NotebookParser)


project, author, release = "fbl-gym", "The fbl-gym authors", __version__
copyright = author
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx-mathjax-offline",
    "sphinx.ext.viewcode",
]
html_theme = "furo"
html_static_path, html_css_files = ["static"], ["tables.css"]
html_title = f"fbl-gym {release}"
myst_enable_extensions = ["dollarmath", "amsmath", "substitution"]
os.environ["COLUMNS"] = "100"  # of the commands' help
myst_substitutions = {
    "datasheet": inspect.getdoc(TwoLinkArmEnv),  # the docstring is in Markdown, as Gymnasium's are
    "records": "```{eval-rst}\n" + "\n".join(f".. autoclass:: fbl_gym.{name}" for name in RECORDS) + "\n```\n",
    "tracking": inspect.getdoc(TwoLinkArmTrackingEnv).partition("\nArgs:")[0],
    "commands": "\n".join(f"## {name}\n\n```text\n{prepare(name)[0].format_help()}```\n" for name in COMMANDS),
}
myst_heading_anchors = 3
exclude_patterns = ["explanation/paper/claims.md", "_build"]
autodoc_member_order = "bysource"
autodoc_typehints = "none"
autodoc_default_options = {"members": True}
default_role = "code"  # docstrings put code between single backticks
napoleon_google_docstring, napoleon_numpy_docstring = True, False
napoleon_use_ivar = True  # fields of a dataclass are documented once, under Attributes
