"""The subcommands of `touchd`, a module each with `main(arguments) -> exit code`."""
