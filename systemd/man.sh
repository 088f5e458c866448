#!/bin/sh
# Prints the manual page of touchd, made from its --help: sh man.sh PYTHON
export COLUMNS=80
touchd="$1 -m touchd.daemon"
# The program's own path is that of the machine where this runs.
own="s#$1 -m touchd.daemon#touchd#g; s#[^ (]*/bin/touchd#touchd#g"
literal() { echo .nf; sed "$own" | sed 's/\\/\\e/g; s/-/\\-/g; s/^[.'\'']/\\\&&/'; echo .fi; }

echo ".TH TOUCHD 1 \"\" \"$($touchd version)\""
echo ".SH NAME"
echo "touchd \\- social touch on a pressure pad, for a Nao robot"
echo ".SH COMMANDS"
$touchd --help | literal
for command in $($touchd --help | sed -n 's/^  touchd \([a-z-]*\) .*/\1/p'); do
    echo ".SH $command"
    $touchd "$command" --help | literal
done
echo ".SH FILES"
echo "touchd.yaml, ~/.config/touchd/touchd.yaml, /etc/touchd/touchd.yaml: the first that is there is the configuration"
