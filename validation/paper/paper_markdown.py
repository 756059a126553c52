"""The text of `mirage reproduce`: DIR/TABLE.md for each table and DIR/reproduce.md with all of them, from DIR/reproduce.json."""

import math
import os

from atomic import write as write_file


def number(value, otherwise=math.nan):
    """JSON stores infinite values as null."""
    return otherwise if value is None else value


def percent(share):
    """"31.9 (24.1–40.0)"; the value alone if it has no interval."""
    text = f"{100 * number(share['value']):.1f}"
    if "low" not in share:
        return text
    return f"{text} ({100 * number(share['low'], -math.inf):.1f}–{100 * number(share['high'], math.inf):.1f})"


def signed(share):
    """"+7.1", in points; a share that rounds to zero has no sign."""
    text = f"{100 * share:+.1f}"
    return "0.0" if text in ("+0.0", "-0.0") else text.replace("-", "−")


def points(difference):
    """"+7.1 (0.0 to +17.5)": a difference of shares, in points."""
    low, high = number(difference["low"], -math.inf), number(difference["high"], math.inf)
    return f"{signed(number(difference['value']))} ({signed(low)} to {signed(high)})"


def escaped(text):
    """Escapes bars, which would end a cell."""
    return text.replace("|", "\\|").replace("\n", " ")


def remarks(row):
    """The basis of the row's numbers, and its warnings."""
    parts = []
    if "vehicles" in row:
        parts.append(f"{row['vehicles']} in {row['frames']} frames" +
                     "".join(f", {row[what]} {what}" for what in ("meshes", "runs") if row[what] > 1))
    text = "".join(parts)
    if "few_clusters" in row:
        text += "; " + row["few_clusters"]
    if "note" in row:
        text += "; " + escaped(row["note"])
    if "error" in row:
        text += ("; " if parts else "") + escaped(row["error"])
    return text


def plain_table(table):
    rows, columns = table["rows"], table["columns"]
    rigs = any(row["rig"] != rows[0]["rig"] for row in rows)
    paper = {key for row in rows for key in row["paper"]}
    head = ["data", ""] if rigs else [""]
    for column in columns:
        head += [f"{column['title']}, {'points' if column['key'].startswith('net') else '%'}"] + (["paper"] if column["key"] in paper else [])
    head += ["found clean at IoU 0.7", "minutes"]  # FN ASR and ASR count these; *vanished* those at 0.1 (arms)
    lines = ["|" + "".join(f" {cell} |" if cell else " |" for cell in head), "|" + "---|" * len(head)]
    for row in rows:
        cells = ([row["rig"]] if rigs else []) + [escaped(row["label"])]
        for column in columns:
            key = column["key"]
            form = points if key.startswith("net") else percent
            cells.append(form(row["values"][key]) if key in row["values"] else "–")
            if key in paper:
                cells.append(f"{100 * row['paper'][key]:.2f}" if key in row["paper"] else "")
        text = "|" + "".join(f" {cell} |" if cell else " |" for cell in cells) + f" {remarks(row)} |"
        lines.append(text + (f" {row['minutes']:.1f} |" if "minutes" in row else " |"))
    return f"## {table['name']}: {table['title']}\n\n" + (table["note"] + "\n\n" if table["note"] else "") + "\n".join(lines) + "\n\n"


def net_cell(values, key):
    """"8.6; +7.1 (0.0 to +17.5)": a share, and net of its control."""
    if key not in values:
        return "–"
    text = f"{100 * number(values[key]['value']):.1f}"
    net = values.get("net_" + key)
    if not net:
        return text
    return f"{text}; {points(net)}"


def matrix(table):
    """By source and target: a matrix a quantity that has a net, and one of the vehicles; then missing entries and why."""
    rows = table["rows"]
    sources, targets = (list(dict.fromkeys(row[end] for row in rows)) for end in ("source", "target"))
    cells = {}
    for row in rows:
        cells.setdefault((row["source"], row["target"]), row)
    head, rule = "".join(f" {target} |" for target in targets), "|---|" + "---|" * len(targets)
    text = f"## {table['name']}: {table['title']}\n\n{table['note']}\n\n"
    for column in table["columns"]:
        key = column["key"]
        if key.startswith("net"):
            continue
        text += f"| {column['title']}, %{'' if key == 'fp_asr' else '; net, points (95 %)'} |{head}\n{rule}\n"
        for source in sources:
            text += f"| {source} |"
            for target in targets:
                row = cells.get((source, target))
                cell = net_cell(row["values"], key) if row else "–"
                text += f" **{cell}** |" if source.startswith(target + ",") else f" {cell} |"
            text += "\n"
        text += "\n"
    counted = {row["target"]: f"{row['vehicles']} in {row['frames']}" for row in rows if "vehicles" in row}
    text += f"| vehicles found clean at IoU 0.7 |{head}\n{rule}\n| in frames |"
    text += "".join(f" {counted.get(target, '–')} |" for target in targets) + "\n\n"
    for row in rows:
        text += "".join(f"- {row['label']}: {row[key]}\n" for key in ("note", "error") if key in row)
    return text + "\n"


def findings_text(findings):
    text = "## The paper's findings\n\n"
    for finding in findings:
        text += f"- **{finding['claim']}**" + ("" if finding["checks"] else ": not measured in this run.") + "\n"
        for check in finding["checks"]:
            why = f" ({check['why']})" if check["why"] else ""
            text += f"  - {check['rig']}: {check['verdict']}. {check['sentence']}.{why}\n"
    return text


def write(folder, result):
    text = "# The experiments of Tu et al. (CoRL 2021)\n\n"
    for table in result["tables"]:
        written = matrix(table) if table["matrix"] else plain_table(table)
        write_file(os.path.join(folder, table["name"] + ".md"), written)
        text += written
    text += "## Whether the detectors use their pictures\n\n"
    text += "".join(f"- {one['case']}: {one['words']}.\n" for one in result["reliance"]) + "\n"
    write_file(os.path.join(folder, "reproduce.md"), text + findings_text(result["findings"]))
