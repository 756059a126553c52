"""Runs a notebook in this Python and writes it with its outputs, without Jupyter:

    PYTHONPATH=build/python /usr/bin/python3 src/guide/notebook.py NOTEBOOK [OUT]

It keeps each cell's printed text, the value of its last expression, and its figures as small PNGs.
"""

import ast
import base64
import contextlib
import io
import json
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

DOTS_PER_INCH = 60


def value_of(source, names):
    """Runs a cell; returns the value of its last expression, or None."""
    tree, last = ast.parse(source), None
    if isinstance(tree.body[-1], ast.Expr) and not source.rstrip().endswith(";"):
        last = ast.Expression(tree.body.pop().value)
    exec(compile(tree, "<cell>", "exec"), names)
    return None if last is None else eval(compile(last, "<cell>", "eval"), names)


def lines(text):
    return text.splitlines(keepends=True)


def figures():
    """The open figures as PNGs; closes them."""
    for number in plt.get_fignums():
        picture = io.BytesIO()
        plt.figure(number).savefig(picture, dpi=DOTS_PER_INCH, bbox_inches="tight", metadata={"Software": None})
        yield base64.b64encode(picture.getvalue()).decode()
    plt.close("all")


def outputs_of(source, names, count):
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        value = value_of(source, names)
    outputs = []
    if printed.getvalue():
        outputs.append({"output_type": "stream", "name": "stdout", "text": lines(printed.getvalue())})
    shown = list(figures())  # the last expression of a plotting cell is an axis or a legend
    if value is not None and not (shown and type(value).__module__.startswith("matplotlib")) and not isinstance(value, list):
        outputs.append({"output_type": "execute_result", "execution_count": count, "metadata": {},
                        "data": {"text/plain": lines(repr(value))}})
    for png in shown:
        outputs.append({"output_type": "display_data", "metadata": {}, "data": {"image/png": png}})
    return outputs


def main():
    path = sys.argv[1]
    with open(path, encoding="utf-8") as file:
        notebook = json.load(file)
    names, count = {"__name__": "__main__"}, 0
    for cell in notebook["cells"]:
        if cell["cell_type"] != "code":
            continue
        count += 1
        cell["outputs"] = outputs_of("".join(cell["source"]), names, count)
        cell["execution_count"] = count
    with open(sys.argv[2] if len(sys.argv) > 2 else path, "w", encoding="utf-8") as file:
        json.dump(notebook, file, indent=1, ensure_ascii=False)
        file.write("\n")


if __name__ == "__main__":
    main()
