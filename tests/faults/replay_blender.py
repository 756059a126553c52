"""Blender, asked once: what validate asks of it a second time is answered from what it said the first time.

    blender RECORDS REAL [Blender's arguments]

Stands in for Blender where a command is run a hundred times. A job is known by what it asks, with the contents of the files that
it names instead of their names; a new one goes to the real Blender, which is started then.
"""
import hashlib
import json
import os
import shutil
import subprocess
import sys

INPUTS, OUTPUT = ("scene", "rays", "mesh"), "output"


def key_of(job):
    asked = {name: value for name, value in job.items() if name not in ("id", OUTPUT)}
    for name in INPUTS:
        if name in asked:
            with open(asked[name], "rb") as file:
                asked[name] = hashlib.sha256(file.read()).hexdigest()
    return hashlib.sha256(json.dumps(asked, sort_keys=True).encode()).hexdigest()


class Real:
    def __init__(self, command):
        self.command, self.child = command, None

    def ask(self, job):
        if self.child is None:
            self.child = subprocess.Popen(self.command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.child.stdin.write(json.dumps(job) + "\n")
        self.child.stdin.flush()
        for line in self.child.stdout:
            try:
                answer = json.loads(line)
            except ValueError:
                continue  # what it prints before the worker runs
            if isinstance(answer, dict) and answer.get("id") == job["id"]:
                return answer
        sys.exit(3)


def answered(job, records, real):
    record = os.path.join(records, key_of(job))
    if not os.path.exists(record + ".json"):
        answer = real.ask(job)
        if not answer["ok"]:
            return answer
        if OUTPUT in job:
            shutil.copyfile(job[OUTPUT], record)
        with open(record + ".json", "w", encoding="utf-8") as file:
            json.dump(answer, file)
        return answer
    with open(record + ".json", encoding="utf-8") as file:
        answer = json.load(file)
    try:
        if OUTPUT in job:
            shutil.copyfile(record, job[OUTPUT])
    except OSError as error:  # as Blender says that it can't write
        return {"id": job["id"], "ok": False, "error": str(error)}
    return {**answer, "id": job["id"]}


def main(records, *command):
    real = Real(command)
    for line in sys.stdin:
        job = json.loads(line)
        print(json.dumps(answered(job, records, real)), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
