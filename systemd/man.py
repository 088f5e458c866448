"""Prints the manual page of touchd, made from its --help; run it with the Python that has touchd."""

import io
import os
import re
import sys
from contextlib import redirect_stdout, suppress

from touchd.daemon.app import cli

PLACES = "touchd.yaml, ~/.config/touchd/touchd.yaml, /etc/touchd/touchd.yaml"
FILES = f"{PLACES}: the first that is there is the configuration"


def printed(*arguments: str) -> str:
    """Return what touchd prints, as literal text, without the path of the program on this machine."""
    with redirect_stdout(io.StringIO()) as out, suppress(SystemExit):
        cli.main(arguments)
    text = out.getvalue().replace(f"{sys.executable} -m touchd.daemon", "touchd")
    text = re.sub(r"[^ (\n]*/bin/touchd", "touchd", text)
    return re.sub(r"^(?=[.'])", r"\\&", text.replace("\\", "\\e").replace("-", "\\-"), flags=re.MULTILINE)


def main() -> None:
    os.environ["COLUMNS"] = "80"
    sections = [("COMMANDS", printed("--help"))]
    sections += [(command, printed(command, "--help")) for command in cli.COMMANDS]
    page = f'.TH TOUCHD 1 "" "{printed("version").strip()}"\n.SH NAME\n'
    page += "touchd \\- social touch on a pressure pad, for a Nao robot\n"
    page += "".join(f".SH {title}\n.nf\n{text}.fi\n" for title, text in sections)
    sys.stdout.write(f"{page}.SH FILES\n{FILES}\n")


if __name__ == "__main__":
    main()
