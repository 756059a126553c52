#!/usr/bin/python3
"""What Doxygen reads in place of a header: doxygen_filter.py HEADER prints it, line by line as the header has it.

The headers are written for readers of the code: plain comments, one comment for `double left = 0, top = 0;`. Here
- the comment that a file begins with becomes the file's,
- plain comments before or behind a declaration become Doxygen's (`//` and, in the C headers, `/* */`),
- several names in one declaration become one declaration each, every one with the comment of all,
- a data member without a comment gets an empty one: a plain field's name and type may say all. Functions, types, constants and
  macros have no such excuse.
"""

import re
import sys

TRAILING = re.compile(r"^(?P<code>\s*\S.*?[;,{}])\s+(?://(?!/)|///<|/\*(?=.*\*/))\s?(?P<text>.*?)(?:\s*\*/)?$")
# A field or a constant, no function: words and template arguments, then names with or without an initial value.
DECLARATION = re.compile(r"^(?P<indent>\s*)(?P<type>(?:static |constexpr |inline |mutable |const )*[\w:]+(?:<.*?>)?(?: const)?[*&]?) "
                         r"(?P<names>[\w\[\]]+\s*(?:=.*|\{.*\})?,.*);$")

SILENT = "&nbsp;"
MEMBER = re.compile(r"^\s+(?!using |return |friend |typedef |static )(?:const |mutable )?[\w:]+(?:<.*>)?(?: const)?[*&]* [\w\[\], ]+\s*(?:=.*|\{.*\})?;$")


def parts(names):
    """The pieces between the commas outside of brackets and braces."""
    depth, piece, found = 0, "", []
    for letter in names:
        depth += (letter in "<([{") - (letter in ">)]}")
        if letter == "," and depth == 0:
            found.append(piece.strip())
            piece = ""
        else:
            piece += letter
    return [*found, piece.strip()]


def apart(code, text):
    """`int a = 0, b = 0;` as two declarations with the same comment, on one line; None if it is none."""
    match = DECLARATION.match(code)
    if not match or match["type"] in ("return", "using", "template", "throw") or code.count("(") != code.count(")"):
        return None
    names = parts(match["names"])
    if len(names) < 2 or not all(re.match(r"^[*&]?\w+", name) for name in names):
        return None
    return match["indent"] + " ".join(f"{match['type']} {name}; /**< {text.replace('*/', '')} */" for name in names)


def filtered(lines):
    heading = bool(lines) and lines[0].startswith("// ")
    before = []  # the comment that stands before this line
    for number, line in enumerate(lines):
        if heading and line.startswith("//"):
            yield ("/// @file\n/// " if number == 0 else "/// ") + line[2:].lstrip("/").strip()
            continue
        if heading and line.startswith("#pragma once"):
            continue  # whose line the file's name took
        heading = False
        stripped = line.strip()
        if stripped.startswith("//") and not stripped.startswith("///<"):
            text = stripped.lstrip("/").lstrip("<").strip()
            before.append(text)
            yield line[: len(line) - len(line.lstrip())] + "/// " + text
            continue
        if "/*" in line and "/**" not in line:
            line = line.replace("/*", "/**<" if line.split("/*")[0].strip() else "/**", 1)
        trailing = TRAILING.match(line)
        code = trailing["code"] if trailing else line
        text = trailing["text"] if trailing else " ".join(before)
        goes_on = number + 1 < len(lines) and lines[number + 1].strip().startswith("///<")
        several = None if goes_on else apart(code, text or SILENT)
        if several:
            yield several
        elif trailing:
            yield f"{code}  ///< {text}"
        elif not (before or goes_on) and MEMBER.match(line):
            yield f"{line}  ///< {SILENT}"
        else:
            yield line
        before = []


if __name__ == "__main__":
    with open(sys.argv[1], encoding="utf-8") as header:
        print("\n".join(filtered(header.read().split("\n"))), end="")
