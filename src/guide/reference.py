"""The page of all commands, from the program's own help.

    reference.py PROGRAM PAGE            writes the page
    reference.py PROGRAM PAGE --check    compares it; exit code 1 if it differs

An option that several commands describe in the same words, apart from its default, appears once, at the end.
"""

import collections
import re
import subprocess
import sys

# The end of a description: the default, or "required".
STANDARD = re.compile(r"(?: \((?:[^()]*; )?(default [^();]*|required)\)| \(default: ([^()]*)\))$")

HEAD = """# Commands

Every command, what it does, an example, and its options. This page is `mirage COMMAND --help`, written by `make reference`.

    mirage COMMAND [--config FILE.toml] [options]

X is a number, N an integer. A range and the default stand in brackets; where most commands share a default, it stands below.
"""


def ask(program, *arguments):
    return subprocess.run([program, *arguments], capture_output=True, text=True, check=True).stdout


def parsed(text):
    """(description, example lines, [(heading, [(name, text)])]) of a command's help."""
    description, _, rest = text.partition("\n\n")
    groups, example = [], []
    for line in rest.splitlines():
        if re.match(r"^(Example|Examples):", line) or example:
            example.append(line)
        elif re.match(r"^\S.*:$", line) and not line.startswith("Usage"):
            groups.append((line[:-1], []))
        elif groups and re.match(r"^  \S", line):
            name, _, said = line.strip().partition("  ")
            groups[-1][1].append([name, said.strip()])
        elif groups and groups[-1][1] and line.startswith("   "):
            before = groups[-1][1][-1][1]
            within_list = re.search(r"\S,\S+,$", before)  # help breaks a list without spaces at its commas
            groups[-1][1][-1][1] = (before + ("" if within_list else " ") + line.strip()).strip()
    example = re.sub(r"^Examples?:\s*", "", "\n".join(example)).strip()
    return " ".join(description.split()), example, [(h, [tuple(o) for o in options]) for h, options in groups if options]


def without_default(said):
    """(the words that commands share, this command's default)"""
    match = STANDARD.search(said)
    return (said[:match.start()], next(filter(None, match.groups()))) if match else (said, "")


def entry(name, said):
    # Markdown's characters in the text are escaped.
    return f"- `{name}` {re.sub(r'([*_<])', lambda m: chr(92) + m[1], said)}".rstrip()


def page(program):
    commands = [line.split("\t", 1) for line in ask(program, "--completion", "commands").splitlines()]
    helps = {name: parsed(ask(program, name, "--help")) for name, _ in commands}
    users = collections.defaultdict(list)
    for _, _, groups in helps.values():
        for _, options in groups:
            for option, said in options:
                users[option, without_default(said)[0]].append(said)
    shared = {key for key, by in users.items() if len(by) > 1}
    usual = {}
    for key in shared:
        (default, count), = collections.Counter(without_default(said)[1] for said in users[key]).most_common(1)
        usual[key] = default if 2 * count >= len(users[key]) else ""  # no shared default, as for --out
    lines = [HEAD]
    for name, (description, example, groups) in helps.items():
        lines += [f"## {name}", "", description[:1].upper() + description[1:] + ".", "", f"    {example}", ""]
        also = collections.defaultdict(list)  # by the command's default, if it differs from the usual one
        for heading, options in groups:
            own = []
            for option, said in options:
                words, default = without_default(said)
                if (option, words) not in shared:
                    own.append((option, said))
                elif option.split()[0] != "-h,--help":
                    its = "" if default == usual[option, words] else default or "no default"
                    also[its].append(f"`{option.split()[0]}`")
            if own:
                lines += [f"**{heading}**", "", *(entry(*option) for option in own), ""]
        if also:
            lists = (", ".join(names) + (f" ({its})" if its else "") for its, names in also.items())
            lines += ["Also, [below](#options-of-several-commands): " + "; ".join(lists) + ".", ""]
    lines += ["## Options of several commands", ""]
    lines += [entry(key[0], limits(key[1], by, usual[key])) for key, by in users.items() if key in shared]
    return "\n".join(lines) + "\n"


def limits(words, by, default):
    """Adds the range and the default that most commands have."""
    match = re.search(r" \(((?:[^()]*; )?)(?:default [^();]*|required)\)$", by[0])
    if default and not re.match("default |required", default):
        default = "default: " + default
    within = [part for part in ((match[1].rstrip("; ") if match else ""), default) if part]
    return f"{words} ({'; '.join(within)})" if within else words


def main(program, path, check=""):
    wanted = page(program)
    if not check:
        with open(path, "w", encoding="utf-8") as file:
            file.write(wanted)
        return 0
    with open(path, encoding="utf-8") as file:
        written = file.read()
    if written == wanted:
        print(f"{path}: as the program says")
        return 0
    apart = next(i for i, (a, b) in enumerate(zip(written.splitlines() + [""], wanted.splitlines() + [""])) if a != b)
    print(f"{path}: line {apart + 1} is not what the program's help says; run make reference\n  page:    "
          f"{(written.splitlines() + [''])[apart]}\n  program: {(wanted.splitlines() + [''])[apart]}")
    return 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
