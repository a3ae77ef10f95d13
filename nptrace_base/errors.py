"""The base class of this project's errors: the user's input cannot be used. Any other exception is a bug."""


class NptraceError(ValueError):
    """An input that cannot be used; the message is one sentence: the value, the rule, the way out."""
