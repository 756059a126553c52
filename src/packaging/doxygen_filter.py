#!/usr/bin/python3
"""What Doxygen reads in place of a header: doxygen_filter.py HEADER prints it, line by line as the header has it.

The headers are written for readers of the code: plain comments, one comment for `double left = 0, top = 0;`. Here
- the comment that a file begins with becomes the file's,
- plain comments before or behind a declaration become Doxygen's (`//` and, in the C headers, `/* */`),
- several names in one declaration become one declaration each, every one with the comment of all, over several lines too,
- a data member without a comment gets an empty one: a plain field's name and type may say all. Functions, types, constants and
  macros have no such excuse,
- functions that many types have by one convention (COMMON) get its sentence where they have no comment of their own,
- bodies of functions stay as they are: Doxygen takes a comment in a body for one on the function.
"""

import re
import sys

TRAILING = re.compile(r"^(?P<code>\s*\S.*?[;,{}])\s+(?://(?!/)|///<|/\*(?=.*\*/))\s?(?P<text>.*?)(?:\s*\*/)?$")
# A field or a constant: words and template arguments, then names with or without an initial value.
DECLARATION = re.compile(r"^(?P<indent>\s*)(?P<type>(?:static |constexpr |inline |mutable |const )*[\w:]+(?:<.*?>)?(?: const)?[*&]?) "
                         r"(?P<names>[*&]?[\w\[\]]+\s*(?:=.*|\{.*\}|\(.*\))?,.*);$")

SILENT = "&nbsp;"
MEMBER = re.compile(r"^\s+(?!using |return |friend |typedef |static )(?:const |mutable )?[\w:]+(?:<.*>)?(?: const)?[*&]* [\w\[\], ]+\s*(?:=.*|\{.*\})?;$")

# Names of base/fields.h: fields of structs, words of enums, and functions that a visitor calls with fields.
COMMON = [(re.compile(r"^\s*" + declaration), text) for declaration, text in (
    (r"constexpr auto words_of\([\w:]+\)", "The words of options and files, in the enumerators' order (base/fields.h)."),
    (r"void visit_fields\(Visitor& visit, S& s\)", "Visits the fields of S, by which files, options and checks know them (base/fields.h)."),
    (r"void operator\(\)\(const Field&", "Visits one field (base/fields.h)."),
    (r"void group\(const Field&", "Visits the fields of a struct whose fields are an object of their own (base/fields.h)."),
    (r"void list\(const Field&", "Visits the fields of a struct whose numbers are one list (base/fields.h)."),
)]
# A scope that holds declarations; any other brace opens a body or a value.
SCOPE = re.compile(r"^\s*(?:template\s*<.*>\s*)?(?:typedef\s+)?(?:class|struct|enum|union|namespace|extern)\b")


def parts(names):
    """Splits at the commas outside of brackets and braces."""
    depth, piece, found = 0, "", []
    for letter, bracket in zip(names, names.replace(" << ", "    ")):
        depth += (bracket in "<([{") - (bracket in ">)]}")
        if letter == "," and depth == 0:
            found.append(piece.strip())
            piece = ""
        else:
            piece += letter
    return [*found, piece.strip()]


def apart(code, text):
    """`int a = 0, b = 0;` as two declarations with the same comment, on one line; None for other code."""
    match = DECLARATION.match(code)
    if not match or match["type"] in ("return", "using", "template", "throw") or code.count("(") != code.count(")"):
        return None
    names = parts(match["names"])
    if len(names) < 2 or not all(re.match(r"^[*&]?\w+", name) for name in names):
        return None
    names = [re.sub(r"^(\w+)\((.*)\)$", r"\1{\2}", name) for name in names]  # else Doxygen takes it for a function
    is_constant = re.search(r"\b(static|constexpr|inline)\b", match["type"])
    comment = "" if not text and is_constant else f" /**< {text.replace('*/', '') or SILENT} */"
    return match["indent"] + " ".join(f"{match['type']} {name};{comment}" for name in names)


def whole(lines, number):
    """The declaration of several names that begins on this line, and its number of lines."""
    code, count = lines[number], 1
    while code.endswith(",") and number + count < len(lines):
        code, count = code + " " + lines[number + count].strip(), count + 1
    return code, count


def enters(line, scopes):
    """Follows the line's braces: True for each open scope of declarations, False for each open body."""
    is_scope = SCOPE.match(line) is not None
    for letter in re.sub(r"""//.*|/\*.*?\*/|"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])'""", "", line):
        if letter == "{":
            scopes.append(is_scope)
        elif letter == "}" and scopes:
            scopes.pop()


def filtered(lines):
    heading = bool(lines) and lines[0].startswith("// ")
    before = []  # the comment before this line
    scopes = []  # open braces
    told = 0  # number of lines already merged into an earlier one
    for number, line in enumerate(lines):
        if heading and line.startswith("//"):
            yield ("/// @file\n/// " if number == 0 else "/// ") + line[2:].lstrip("/").strip()
            continue
        if heading and line.startswith("#pragma once"):
            continue  # whose line the file's name took
        heading = False
        in_body = not all(scopes)
        enters(line, scopes)
        if in_body or told > 0:
            yield line if in_body else ""
            told -= not in_body
            continue
        stripped = line.strip()
        if stripped.startswith("//") and not stripped.startswith("///<"):
            text = stripped.lstrip("/").lstrip("<").strip()
            before.append(text)
            yield line[: len(line) - len(line.lstrip())] + "/// " + text
            continue
        if "/*" in line and "/**" not in line and not re.search(r"\*/\s*\S", line):
            line = line.replace("/*", "/**<" if line.split("/*")[0].strip() else "/**", 1)
        trailing = TRAILING.match(line)
        code = trailing["code"] if trailing else line
        text = trailing["text"] if trailing else " ".join(before)
        goes_on = number + 1 < len(lines) and lines[number + 1].strip().startswith("///<")
        code, count = (code, 1) if trailing else whole(lines, number)
        several = None if goes_on else apart(code, text)
        common = None if before else next((text for pattern, text in COMMON if pattern.match(line)), None)
        if several:
            told = count - 1
            yield several
        elif trailing:
            yield f"{code}  ///< {text}"
        elif common:
            yield f"/** {common} */ {line.strip()}"
        elif not (before or goes_on) and MEMBER.match(line):
            yield f"{line}  ///< {SILENT}"
        else:
            yield line
        if not stripped.startswith("template"):
            before = []


if __name__ == "__main__":
    with open(sys.argv[1], encoding="utf-8") as header:
        print("\n".join(filtered(header.read().split("\n"))), end="")
