"""Interrupts (SIGINT, SIGTERM, SIGHUP, SIGBREAK): when they are deferred, and how the command-line interface ends.

The command ends at once, with one line, and removes incomplete files. An exception would not suffice: Python drops
those raised while a weak reference is cleared or a module is loaded, and the run would continue. Only during the steps
of a run the first signal raises `Interrupted`, so that the solution so far can be written; the second one ends the
process. Nothing expensive is imported here, so that signals are handled from the first line on.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import contextmanager
from importlib.machinery import ModuleSpec
from threading import current_thread, main_thread

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence
    from importlib.abc import Loader
    from types import FrameType, ModuleType
    from typing import Any

# SIGBREAK is Ctrl-Break on Windows, which has no SIGHUP.
_DESCRIPTIONS = {"SIGINT": "interrupted", "SIGTERM": "terminated", "SIGHUP": "hung up", "SIGBREAK": "interrupted"}
_cleanups: list[Callable[[], object]] = []
_raise_enabled = False
_signal_received = 0


class Interrupted(KeyboardInterrupt):
    """The process received an interrupt signal inside `raise_on_interrupt`; `partial` holds the result so far."""

    partial: object = None

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number

    @property
    def description(self) -> str:
        """The kind of interrupt, such as "interrupted" or "hung up"."""
        return _description(self.number)


@contextmanager
def raise_on_interrupt() -> Iterator[None]:
    """Context in which the first interrupt raises `Interrupted` instead of ending the process."""
    global _raise_enabled, _signal_received
    _raise_enabled, _signal_received = True, 0
    try:
        yield
    except Interrupted:
        _raise_enabled, _signal_received = False, 0
        raise
    finally:
        _raise_enabled = False
        if _signal_received:
            _exit_process(_signal_received, None)  # Python dropped the exception


def install_handlers() -> None:
    """Install handlers that end the process at an interrupt, with exit status 128 + number of the signal.

    Signals that the parent process set to be ignored (``nohup``, background jobs) stay ignored.

    >>> import subprocess, sys
    >>> code = "import signal; from coadjoint.interruption import install_handlers; "
    >>> code += "install_handlers(); signal.raise_signal(signal.SIGTERM)"
    >>> subprocess.run([sys.executable, "-c", code], capture_output=True).returncode
    143
    """
    for number in _handled_signals():
        if signal.getsignal(number) not in (signal.SIG_IGN, None):
            signal.signal(number, _exit_process)


def ignore_signals() -> None:
    """Ignore interrupts from now on: at exit Python removes handlers, and a signal would kill it without a message."""
    for number in _handled_signals():
        signal.signal(number, signal.SIG_IGN)


class deferred:
    """Context in which signals are queued in the main thread; their handlers are called at its end."""

    def __enter__(self) -> None:
        self._handlers: dict[int, Callable[[int, FrameType | None], Any]] = {}
        self._waiting: dict[int, FrameType | None] = {}
        self._over = False
        if current_thread() is not main_thread():
            return
        try:
            for number in _handled_signals():
                handler = signal.getsignal(number)
                if callable(handler):
                    self._handlers[number] = handler
                    signal.signal(number, self._queue_signal)
        except BaseException:  # raised by the handler of a signal that came first
            self._restore()
            raise

    def __exit__(self, *error: object) -> None:
        self._restore()
        for number, frame in self._waiting.items():
            self._handlers[number](number, frame)

    def _restore(self) -> None:
        self._over = True
        for number, handler in self._handlers.items():
            signal.signal(number, handler)

    def _queue_signal(self, number: int, frame: FrameType | None) -> None:
        if self._over:  # another handler raised while handlers were restored
            signal.signal(number, self._handlers[number])
            self._handlers[number](number, frame)
        else:
            self._waiting[number] = frame


class _CompleteImports:
    """Import finder that defers signals until a module imported by a call of this package is complete."""

    # An exception inside an import removes the incomplete modules but not their submodules, which do not become
    # attributes of the packages when these are imported again.

    def __init__(self) -> None:
        self._loading = False
        self._loaders: dict[str, Loader] = {}
        self._interrupted: dict[str, ModuleType] = {}

    def find_spec(
        self, name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name in self._interrupted:
            return ModuleSpec(name, self)  # type: ignore[arg-type]
        # Python raises interrupts in the main thread only.
        if self._loading or current_thread() is not main_thread() or not _called():
            return None
        for finder in sys.meta_path:
            if finder is not self and hasattr(finder, "find_spec"):
                spec = finder.find_spec(name, path, target)
                if spec is not None:
                    if spec.loader is not None and hasattr(spec.loader, "exec_module"):
                        self._loaders[name], spec.loader = spec.loader, self  # type: ignore[assignment]
                    return spec
        return None

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """Create a module by the loader that Python found; one that is restored is Python's default module."""
        return None if spec.name in self._interrupted else self._loaders[spec.name].create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        """Load a module, or restore one that was complete when an interrupt was raised, and that Python removed."""
        name = module.__name__
        if name in self._interrupted:
            sys.modules[name] = self._interrupted.pop(name)
            return
        loader = module.__loader__ = self._loaders.pop(name)
        if module.__spec__ is not None:
            module.__spec__.loader = loader
        with deferred():
            self._loading = True
            try:
                loader.exec_module(module)
                self._interrupted[name] = sys.modules.get(name, module)
            finally:
                self._loading = False
        del self._interrupted[name]  # not reached if a handler raises


_complete_imports = _CompleteImports()


def complete_imports() -> None:
    """Defer interrupts while calls of this package import modules, until the modules are complete."""
    if _complete_imports not in sys.meta_path:
        sys.meta_path.insert(0, _complete_imports)  # type: ignore[arg-type]


def _called() -> bool:
    """Return whether a function or module of this package is being executed."""
    frame: FrameType | None = sys._getframe()
    while frame is not None:
        name = str(frame.f_globals.get("__name__"))
        if name != __name__ and name.partition(".")[0] == "coadjoint":
            return True
        frame = frame.f_back
    return False


def register_cleanup(abandon: Callable[[], object]) -> None:
    """Register a cleanup (removal of incomplete files) to run if the process is ended before `unregister_cleanup`."""
    _cleanups.append(abandon)


def unregister_cleanup(abandon: Callable[[], object]) -> None:
    """Unregister a cleanup of `register_cleanup`."""
    _cleanups.remove(abandon)


def _handled_signals() -> list[signal.Signals]:
    return [getattr(signal, name) for name in _DESCRIPTIONS if hasattr(signal, name)]


def _description(number: int) -> str:
    return next(text for name, text in _DESCRIPTIONS.items() if getattr(signal, name, None) == number)


def _exit_process(number: int, frame: FrameType | None) -> None:
    global _signal_received
    if _raise_enabled and not _signal_received:
        _signal_received = number
        raise Interrupted(number)
    ignore_signals()
    for action in (*reversed(_cleanups), sys.stdout.flush):
        try:
            action()
        except Exception:  # the process ends in any case; the next run removes remaining files
            pass
    try:
        # The terminal may show ^C or a progress bar on this line.
        prefix = "\n" if os.isatty(2) else ""
        os.write(2, f"{prefix}coadjoint: {_description(number)}\n".encode())
    except OSError:
        pass
    os._exit(128 + number)
