"""Call a component: the one door through which the host does it.

A call is named (`blame`), watched (`watchdog`, `memory`), guarded (`process_state`, `read_only_guard`),
checked (`HookPoint.check`) and repeated (`repeats`), as `policy` says.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from contextvars import ContextVar
from typing import TYPE_CHECKING, Any, NamedTuple

from ..contract.checks.answers import check_gradient_path
from .blame import Callee, blame
from .memory import LEDGER
from .policy import Checks
from .process_state import left_as_found, no_global_random_numbers, own_random_numbers
from .read_only_guard import NOTHING, ReadOnlyGuard
from .repeats import answer_of
from .watchdog import WATCHDOG

if TYPE_CHECKING:
    from torch import Tensor

    from ..contract.component import Component


class _Call(NamedTuple):
    """The current call into a component; the calls that it makes itself, such as to priors, inherit it."""

    iteration: int | None = None
    guard: ReadOnlyGuard = NOTHING
    random_numbers: bool = True


_OUTSIDE = _Call()
_CALL: ContextVar[_Call] = ContextVar("call", default=_OUTSIDE)


@contextmanager
def calling(
    callee: Callee,
    seed: int,
    checks: Checks,
    *,
    iteration: int | None = None,
    guard: ReadOnlyGuard = NOTHING,
) -> Iterator[None]:
    """The context of a call into a component.

    Errors name it, the watchdog and the memory ledger record it, and it must not change the tensors that it
    receives or the state of the process. Within an iteration it must not use global random generators;
    outside, they are seeded for the call and restored afterwards.

    Args:
        seed: for the global generators.
        iteration: of training; None outside the loop, or for the iteration of the calling component.
        guard: data that it receives, besides those of the calling component.
    """
    outer, random_numbers = _CALL.get(), checks.random_numbers
    if iteration is None:
        iteration, random_numbers = outer.iteration, random_numbers and outer.random_numbers
    call = _Call(iteration, outer.guard + guard, random_numbers)
    generators: AbstractContextManager[None] = nullcontext()
    if iteration is None:
        generators = own_random_numbers(seed)
    elif random_numbers:
        generators = no_global_random_numbers()
    name = str(callee)
    token = _CALL.set(call)
    try:
        with (
            blame(callee, iteration),
            WATCHDOG.watching(name, iteration),
            LEDGER.watching(name),
            left_as_found(name, threads=not callee.point.observes),
            generators,
            call.guard.kept(every_bit=checks.every_bit),
        ):
            yield
    finally:
        _CALL.reset(token)


def call(
    callee: Callee,
    component: Component[Any],
    given: tuple[Any, ...],
    checks: Checks,
    *,
    iteration: int | None = None,
    guard: ReadOnlyGuard = NOTHING,
    trained: Sequence[Tensor] = (),
    again: tuple[Any, ...] | None = None,
) -> Any:
    """Call the method of a component's hook point, and return its checked answer.

    Args:
        given: the arguments.
        checks: besides those of every call.
        iteration, guard: see `calling`.
        trained: leaves; a gradient of the answer must reach one of them. Empty: not checked.
        again: the arguments for the repetition; None: the same.

    Raises:
        ExplainedError: names the component.
    """
    point = callee.point
    with calling(callee, component.context.seed, checks, iteration=iteration, guard=guard):
        within = checks.repeat_within
        answer = answer_of(component, point.method, given, within, again=again)
        answer = point.check(answer, *given)
        if trained and checks.gradient_path:
            check_gradient_path(answer, trained)
    return answer
