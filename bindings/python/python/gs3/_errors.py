"""What gs3 raises."""


class Gs3Error(Exception):
    """Any error of gs3: one line that says what, what was expected and what was found."""


class InputError(Gs3Error, ValueError):
    """A value, a shape or the content of a file that gs3 does not accept."""


class Unsupported(Gs3Error, NotImplementedError):
    """An argument that gsplat has and gs3 does not."""


class FileError(Gs3Error, OSError):
    """A file that cannot be read or written."""


class DeviceError(Gs3Error, RuntimeError):
    """A device that cannot be opened, has no room, or failed."""


class Cancelled(Gs3Error, RuntimeError):
    """A progress callback returned ``False``."""
