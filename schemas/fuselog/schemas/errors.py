"""The errors of fuselog: one small tree, each building its own message, handled once at the edge."""


class FuselogError(Exception):
    """Anything that fuselog reports to its user in one line, without a traceback."""


class SchemaError(FuselogError):
    """A message definition that cannot be understood, or a field path that it does not have."""

    def __init__(self, schema: str, reason: str) -> None:
        super().__init__(f"{schema}: {reason}")
        self.schema = schema
        self.reason = reason


class LogError(FuselogError):
    """A log that cannot be read at one place: the file, the byte offset in it, and why."""

    def __init__(self, path: str, offset: int, reason: str) -> None:
        super().__init__(f"{path if path.isprintable() else repr(path)}: byte {offset}: {reason}")
        self.path = path
        self.offset = offset
        self.reason = reason


class ConfigError(FuselogError):
    """Everything wrong with a configuration, each problem with its place ``file:line:col``."""

    def __init__(self, problems: list[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems
