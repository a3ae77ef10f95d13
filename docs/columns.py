"""``python docs/columns.py OUT COLUMN,COLUMN... IN.csv...``: some columns of several CSV files in one; floats to 5 digits."""

import csv
import sys
from pathlib import Path


def short(text: str) -> str:
    """Return a number with five digits after the point, anything else as it is."""
    try:
        return text if text.lstrip("-").isdigit() else f"{float(text):.5f}"
    except ValueError:
        return text


def main(out: str, columns: str, *files: str) -> None:
    """Write the columns."""
    names = columns.split(",")
    with open(out, "w", encoding="utf-8", newline="") as made:
        writer = csv.writer(made, lineterminator="\n")
        writer.writerow(names)
        for file in files:
            with open(Path(file), encoding="utf-8", newline="") as rows:
                writer.writerows([short(row[name]) for name in names] for row in csv.DictReader(rows))


if __name__ == "__main__":
    main(*sys.argv[1:])
