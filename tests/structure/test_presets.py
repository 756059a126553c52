"""Each preset sets every option of CMakeLists.txt: a missing option would keep the value that another preset of its folder, or a
command line, gave it. The Makefile gives no option beside a preset, for the same reason.

    python3 tests/structure/test_presets.py SOURCE
"""

import json
import os
import re
import sys


def variables(presets, name):
    """{cache variable: value} of a preset, those that it inherits included."""
    preset = presets[name]
    parents = preset.get("inherits", [])
    found = {}
    for parent in [parents] if isinstance(parents, str) else parents:
        found = {**variables(presets, parent), **found}
    return {**found, **preset.get("cacheVariables", {})}


def missing(options, presets):
    """(preset, option) of every option that a preset does not set."""
    return [(name, option) for name, preset in presets.items() if not preset.get("hidden")
            for option in sorted(options - variables(presets, name).keys())]


def main(source):
    with open(os.path.join(source, "CMakeLists.txt"), encoding="utf-8") as file:
        options = set(re.findall(r"^option\((\w+)", file.read(), re.M))
    with open(os.path.join(source, "CMakePresets.json"), encoding="utf-8") as file:
        presets = {preset["name"]: preset for preset in json.load(file)["configurePresets"]}
    with open(os.path.join(source, "Makefile"), encoding="utf-8") as file:
        given = {(preset, option) for preset, rest in re.findall(r"cmake --preset (\w+)((?:\\\n|.)*)", file.read())
                 for option in re.findall(r"-D(MIRAGE_\w+)", rest) if option in options}
    wrong = [f"CMakePresets.json: preset {name} does not set {option}" for name, option in missing(options, presets)]
    wrong += [f"Makefile: gives {option} beside preset {name}, whose folder keeps it" for name, option in sorted(given)]
    for line in wrong:
        print(line)
    print(f"{len(options)} options, {len(presets)} presets, {len(wrong)} wrong")
    sys.exit(1 if wrong or len(options) < 5 or len(presets) < 5 else 0)


def planted():
    """The search finds planted errors; otherwise it might find nothing."""
    base = {"hidden": True, "cacheVariables": {"A": "ON"}}
    assert missing({"A", "B"}, {"base": base, "one": {"inherits": "base"}}) == [("one", "B")]
    assert not missing({"A", "B"}, {"base": base, "one": {"inherits": ["base"], "cacheVariables": {"B": "OFF"}}})


if __name__ == "__main__":
    planted()
    main(sys.argv[1])
