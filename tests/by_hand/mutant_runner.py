"""A pytest plugin that runs tests against mutants of one module. See `mutants`.

It collects the tests once, and runs them once to see which lines of the module each of them reaches. For each
mutant it forks: the child exchanges the module's code for the mutant's and runs the tests that reach the
changed line until one fails, those first that caught other mutants or are quick. A mutant outside functions
and constants, such as a bound of a setting, needs all modules reloaded; the child then starts a new pytest.
"""

import ast
import functools
import json
import os
import resource
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType, FrameType, FunctionType, ModuleType
from typing import Any

import pytest
from _pytest.runner import runtestprotocol

# From the command: the module's file, its mutants, where to report, processor seconds for each mutant.
FILE, MUTANTS, REPORT, SECONDS = (
    os.environ.get(f"MUTANTS_{name}", "") for name in ("FILE", "LIST", "REPORT", "SECONDS")
)
OURS = ("touchd", "rigs", "test_", "conftest")
# A mutant that takes this many times as long as the tests, and this much more, waits for ever.
PATIENCE, PATIENCE_S = 6.0, 20.0


@dataclass
class Item:
    """A test, the module's lines that it reaches, and how long it takes."""

    test: pytest.Item
    cpu_s: float = 0.0
    wall_s: float = 0.0
    lines: set[int] = field(default_factory=set)


def run(items: list[pytest.Item]) -> str:
    """Run tests until one fails; return its name, "" if none does."""
    for item, following in zip(items, [*items[1:], None], strict=True):
        if any(report.failed for report in runtestprotocol(item, nextitem=following, log=False)):
            return item.nodeid
    return ""


def measured(test: pytest.Item, following: pytest.Item) -> tuple[Item, bool]:
    """Run a test; return what it reaches and whether it passed."""
    item, is_ours = Item(test), dict[CodeType, bool]()

    def in_module(frame: FrameType, event: str, _: Any) -> Callable[..., Any]:
        if event == "line":
            item.lines.add(frame.f_lineno)
        return in_module

    def trace(frame: FrameType, event: str, _: Any) -> Callable[..., Any] | None:
        code = frame.f_code
        if code not in is_ours:
            is_ours[code] = os.path.realpath(code.co_filename) == os.path.realpath(FILE)
        if not is_ours[code]:
            return None
        item.lines.add(frame.f_lineno)
        return in_module

    began_cpu_s, began_s = time.process_time(), time.monotonic()
    threading.settrace(trace)
    sys.settrace(trace)
    reports = runtestprotocol(test, nextitem=following, log=False)
    sys.settrace(None)
    threading.settrace(None)  # type: ignore[arg-type]
    item.cpu_s, item.wall_s = time.process_time() - began_cpu_s, time.monotonic() - began_s
    return item, not any(report.failed for report in reports)


def place_of(tree: ast.Module, line: int) -> tuple[set[int], bool, bool]:
    """Return the lines of the statement at a line, and whether it is in a function, and a constant."""
    lines, in_function, is_constant = {line}, False, False
    for node in ast.walk(tree):
        if not isinstance(node, ast.stmt) or not node.lineno <= line <= (node.end_lineno or line):
            continue
        body: list[ast.stmt] = getattr(node, "body", [])
        last = body[0].lineno - 1 if body else node.end_lineno or line
        if line <= last:
            lines |= set(range(node.lineno, last + 1))
        in_function |= isinstance(node, ast.FunctionDef)
        is_constant |= isinstance(node, ast.Assign) and node in tree.body
    return lines, in_function, is_constant


def exchange(module: ModuleType, code: str) -> None:
    """Give a module's functions and constants the code and values of a mutant, wherever they are in use."""
    mutant = ModuleType(module.__name__)
    vars(mutant).update({name: vars(module)[name] for name in ("__file__", "__package__", "__spec__")})
    exec(compile(code, str(module.__file__), "exec"), vars(mutant))
    for name, new in vars(mutant).items():
        old = vars(module).get(name)
        if name.startswith("__") or isinstance(old, ModuleType):
            continue
        if isinstance(old, FunctionType | type):
            if old.__module__ == module.__name__:
                exchange_code(old, new)
            continue
        users = [each for key, each in sys.modules.items() if key.startswith(OURS)]
        for user in users:
            if vars(user).get(name) is old:
                vars(user)[name] = new


def exchange_code(old: Any, new: Any) -> None:
    """Give a function, or all functions of a class, the code of another."""
    if isinstance(old, FunctionType):
        old.__code__, old.__defaults__, old.__kwdefaults__ = (
            new.__code__,
            new.__defaults__,
            new.__kwdefaults__,
        )
        if hasattr(old, "__wrapped__"):
            exchange_code(old.__wrapped__, new.__wrapped__)
    elif isinstance(old, property | functools.cached_property | staticmethod | classmethod):
        for name in ("fget", "fset", "func", "__func__"):
            if getattr(old, name, None) is not None:
                exchange_code(getattr(old, name), getattr(new, name))
    elif isinstance(old, type):
        for name, value in vars(new).items():
            if name in vars(old) and name not in ("__dict__", "__weakref__", "__wrapped__"):
                exchange_code(vars(old)[name], value)


def run_anew(items: list[pytest.Item]) -> str:
    """Run tests in a new session of pytest, which imports every module of ours again."""
    for name in [name for name in sys.modules if name.startswith(OURS)]:
        del sys.modules[name]
    os.environ["MUTANTS_FILE"] = ""
    null = os.open(os.devnull, os.O_WRONLY)
    os.dup2(null, 1)
    os.dup2(null, 2)
    options = ["-x", "-q", "-n", "0", "-p", "no:cacheprovider"]
    return "" if pytest.main([*options, *(item.nodeid for item in items)]) == 0 else "anew"


def caught_by(items: list[Item], attempt: Callable[[list[pytest.Item]], str]) -> str:
    """Run tests in a child; return which one failed, or why the child ended, "" if all pass."""
    cpu_s, wall_s = sum(item.cpu_s for item in items), sum(item.wall_s for item in items)
    read, write = os.pipe()
    child = os.fork()
    if not child:
        os.setsid()
        resource.setrlimit(resource.RLIMIT_CPU, (round(5 + 3 * cpu_s), round(6 + 3 * cpu_s)))
        try:
            why = attempt([item.test for item in items])
        except BaseException as error:
            why = f"{type(error).__name__}: {error}"
        os.write(write, (why or "-").encode()[:500])
        os._exit(0)
    os.close(write)
    until_s = time.monotonic() + PATIENCE_S + PATIENCE * wall_s
    while os.waitpid(child, os.WNOHANG)[0] == 0:
        if time.monotonic() > until_s:
            os.kill(child, signal.SIGKILL)
        time.sleep(0.005)
    with suppress(ProcessLookupError):
        # What the tests have started.
        os.killpg(child, signal.SIGKILL)
    why = os.read(read, 500).decode()
    os.close(read)
    return "" if why == "-" else why or "it took too long"


def chosen(items: list[Item], lines: set[int], caught: Counter[str]) -> list[Item]:
    """Return the tests that reach these lines, as many as the time for a mutant allows."""
    reaching = [item for item in items if item.lines & lines]
    reaching.sort(key=lambda item: item.cpu_s / (1 + 3 * caught[item.test.nodeid]))
    left_s, within = float(SECONDS), list[Item]()
    for item in reaching:
        left_s -= item.cpu_s
        if left_s < 0:
            break
        within.append(item)
    return within


def pytest_runtestloop(session: pytest.Session) -> bool | None:
    if not FILE or not os.environ["MUTANTS_FILE"]:
        return None
    path = Path(FILE)
    source, tests = path.read_text(), session.items
    tree, name = ast.parse(source), "touchd." + FILE.removesuffix(".py").replace("/", ".")
    runs = [measured(test, following) for test, following in zip(tests, [*tests[1:], tests[0]], strict=True)]
    failed = [item.test.nodeid for item, is_passed in runs if not is_passed]
    items, caught = [item for item, is_passed in runs if is_passed], Counter[str]()
    everywhere = set().union(*(item.lines for item in items))
    with open(REPORT, "w", buffering=1) as report:
        for number, line in enumerate(Path(MUTANTS).read_text().splitlines()):
            mutant = json.loads(line)
            lines, in_function, is_constant = place_of(tree, mutant["line"])
            some = chosen(items, lines if in_function else everywhere, caught)

            def attempt(
                tests: list[pytest.Item],
                code: str = mutant["code"],
                anew: bool = not (in_function or is_constant),
            ) -> str:
                if anew:
                    return run_anew(tests)
                exchange(sys.modules[name], code)
                return run(tests)

            # Programs that tests start read the file; another time of change makes Python compile it again.
            path.write_text(mutant["code"])
            os.utime(path, (10 * number, 10 * number))
            why = caught_by(some, attempt) if some else ""
            caught[why] += 1
            changed = mutant["code"].splitlines()[mutant["line"] - 1].strip()
            report.write(json.dumps({"line": mutant["line"], "changed": changed, "caught": why}) + "\n")
    path.write_text(source)
    if failed:
        sys.exit(f"fail without a mutant, and are left out: {', '.join(failed)}")
    return True
