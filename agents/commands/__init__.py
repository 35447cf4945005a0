"""The subcommands of ``offroad``: one module each, a dataclass of arguments with a ``run`` method."""
