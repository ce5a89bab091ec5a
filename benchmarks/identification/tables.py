"""Tables of numbers in files of any maker: text, .mat and .parquet."""

import io
import re
from pathlib import Path
from typing import Any

import numpy as np
from scipy.io import loadmat

from fbl_gym.reading import read_bytes, read_text


def read_table(path: Path) -> Any:
    """Return a `pandas.DataFrame` of a file's numbers, NaN where there is none.

    Its index has the lines of the file, or rows if it has none. Columns without a header are "0",
    "1" and so on; those of a matrix q of MATLAB "q_0", "q_1".
    """
    import pandas as pd  # it takes long to import

    if path.suffix == ".parquet":
        table = pd.read_parquet(io.BytesIO(read_bytes(path)))
    elif path.suffix == ".mat":
        fields = {name: value for name, value in loadmat(io.BytesIO(read_bytes(path))).items() if np.ndim(value) == 2}
        tall = {name: pd.DataFrame(value if len(value) >= len(value.T) else value.T) for name, value in fields.items()}
        table = pd.concat([value.add_prefix(f"{name}_") for name, value in tall.items()], axis=1)
    else:
        table = _read_text(read_text(path))
    table.columns = [str(name).strip() for name in table.columns]
    return table.apply(pd.to_numeric, errors="coerce")


def _read_text(text: str) -> Any:
    """Return the table of a text, whatever its separators, comments and decimal signs are."""
    import pandas as pd

    lines = {n: line for n, line in enumerate(text.lstrip("\ufeff").split("\n"), 1) if line.strip()}
    rows = {n: line for n, line in lines.items() if line.lstrip()[0] not in "#%"}
    first = min(rows, default=0)
    separator = next((each for each in ";\t," if each in rows.get(first, "")), r"\s+")
    parts = re.split(separator, rows.get(first, "").strip())
    above = [line.lstrip("#% ") for n, line in lines.items() if n < first]
    header = not any(re.fullmatch(r"[-+.,\d\s]*\d[-+.,eE\d\s]*", part) for part in parts)
    if not header and above and len(re.split(separator, above[-1].strip())) == len(parts):
        rows, header = {0: above[-1], **rows}, True  # NumPy writes its header as a comment
    comma = separator != "," and any("," in line for line in [*rows.values()][1:4])
    table = pd.read_csv(
        io.StringIO("\n".join(rows.values())), sep=separator, decimal="," if comma else ".", header=0 if header else None,
        index_col=False, skipinitialspace=True,
    )  # fmt: skip
    return table.set_axis([*rows][header:])
