"""Studies behind ``offroad reproduce``: one module each, with a dataclass of arguments that has ``run()``."""
