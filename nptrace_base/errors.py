"""The base class of this project's errors: what the user gave cannot be used. Anything else that is raised is a bug."""


class NptraceError(ValueError):
    """An input that cannot be used; the message is one sentence: the value, the rule, the way out."""
