#!/usr/bin/env python3
"""Runs every fuzzer for a while and says how fast it was and what it found.

    tests/fuzz/run.py BUILD [--seconds 60] [--executions N] [parser ...]

Corpora are kept in BUILD/corpus/PARSER, findings in BUILD/findings/PARSER. Exit code 1 with a finding. Put a
finding, once mended, into tests/fuzz/regressions/PARSER under a name that says what it was: make test replays it.
"""
import argparse
import json
import os
import pathlib
import re
import subprocess
import sys
import time

HERE = pathlib.Path(__file__).resolve().parent
# Bytes; 4096 for the others. A picture of 512 may claim four million pixels, which take their time; three lines or
# objects do what a hundred do, in a third of the time.
LONGEST = {"gltf": 8192, "png": 512, "nuscenes": 2304, "tracking": 1024, "tracklets": 2048}
LIMITS = ["-timeout=20", "-rss_limit_mb=2048", "-malloc_limit_mb=1024", "-report_slow_units=10", "-reload=0"]
# No stacks of allocations, which take a tenth to a fifth of the time: a finding, run alone, tells them.
OPTIONS = {"ASAN_OPTIONS": "detect_leaks=0:allocator_may_return_null=1:malloc_context_size=0:quarantine_size_mb=16",
           "UBSAN_OPTIONS": "print_stacktrace=1", "OPENIMAGEIO_THREADS": "1"}


def fuzz(build, program, parser, arguments):
    corpus, findings = build / "corpus" / parser, build / "findings" / parser
    for folder in (corpus, findings):
        folder.mkdir(parents=True, exist_ok=True)
    before = set(findings.iterdir())
    dictionary = HERE / "dictionaries" / f"{parser}.dict"
    command = [build / program, corpus, build / "seeds" / parser, *LIMITS, f"-artifact_prefix={findings}/",
               f"-max_len={LONGEST.get(parser, 4096)}", "-print_final_stats=1"]
    command += [f"-dict={dictionary}"] if dictionary.exists() else []
    command += [f"-max_total_time={arguments.seconds}"]
    command += [f"-runs={arguments.executions}"] if arguments.executions else []
    start = time.monotonic()
    log = build / f"{parser}.log"
    with open(log, "w") as out:
        code = subprocess.run([str(part) for part in command], stdout=out, stderr=subprocess.STDOUT,
                              env={**os.environ, **OPTIONS, "MIRAGE_FUZZ": parser}).returncode
    seconds = time.monotonic() - start
    said = log.read_text(errors="replace")
    executions = [int(n) for n in re.findall(r"stat::number_of_executed_units: (\d+)", said)]
    covered = re.findall(r" cov: (\d+) ft: (\d+) corp: (\d+)", said)
    # Slow units are told and kept, but are none: what takes 20 s is.
    found = [f for f in set(findings.iterdir()) - before if not f.name.startswith("slow-unit-")]
    return {"parser": parser, "executions": executions[-1] if executions else 0, "seconds": round(seconds, 1),
            "edges": int(covered[-1][0]) if covered else 0, "corpus": int(covered[-1][2]) if covered else 0,
            "findings": sorted(str(f) for f in found), "code": code, "log": str(log)}


def reason(row):
    said = pathlib.Path(row["log"]).read_text(errors="replace")
    for pattern in (r"FINDING in .*", r"SUMMARY: .*", r"ERROR: .*", r".*runtime error: .*", r"MIRAGE_FUZZ: .*"):
        if found := re.search(pattern, said):
            return found.group(0)
    return f"exit code {row['code']}"


def main():
    reader = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    reader.add_argument("build", type=pathlib.Path)
    reader.add_argument("--seconds", type=int, default=60, help="for each parser")
    reader.add_argument("--executions", type=int, default=0, help="stop a parser earlier, after so many")
    reader.add_argument("parsers", nargs="*")
    arguments = reader.parse_intermixed_args()
    build = arguments.build.resolve()
    subprocess.run([build / "fuzz", build / "seeds"], check=True,
                   env={**os.environ, **OPTIONS, "MIRAGE_FUZZ": "seeds"})
    names = sorted(p.name for p in (build / "seeds").iterdir())
    figures = []
    print(f"{'parser':18} {'executions':>11} {'a second':>9} {'edges':>6} {'corpus':>6}  findings", flush=True)
    for parser in arguments.parsers or names:
        row = fuzz(build, "fuzz", parser, arguments)
        row["per_second"] = round(row["executions"] / max(row["seconds"], 1e-9))
        figures.append(row)
        failed = bool(row["findings"]) or row["code"] != 0
        print(f"{parser:18} {row['executions']:11} {row['per_second']:9} {row['edges']:6} {row['corpus']:6}  "
              f"{reason(row) if failed else 'none'}", flush=True)
        for finding in row["findings"]:
            print(f"    {finding}", flush=True)
    (build / "figures.json").write_text(json.dumps(figures, indent=1) + "\n")
    return 1 if any(row["findings"] or row["code"] for row in figures) else 0


if __name__ == "__main__":
    sys.exit(main())
