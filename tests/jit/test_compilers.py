from typing import Any, NamedTuple

from raystream.jit.cpu import device, device_call, kernel
from raystream.jit.intrinsics import no_inline
from raystream.jit.user_loops import as_device


class Choice(NamedTuple):
    function: Any
    amount: int


@device
def double(x):
    return x + x


@device_call
def apply(choice, x):
    no_inline()
    return choice.function(x) + choice.amount


@kernel
def ask(x):
    return apply(Choice(double, x), x)


def test_a_kernel_that_passes_functions_can_be_cached():
    assert ask(5) == 15
    (made,) = ask.overloads.values()
    assert not made.library.has_dynamic_globals


@device_call
def late(x):
    return x + 1


@device
def early(x):
    return late(x)


@device
def middle(x):
    return late(x) * 2


@device
def both(x):
    return early(x) if x < x else middle(x)  # LLVM removes the first call


@kernel
def ask_both(x):
    return both(x)


def test_a_function_is_linked_though_its_first_caller_is_not():
    assert ask_both(3) == 8


def test_users_functions_may_have_closures_and_comprehensions():
    def total(x):
        def square(y):
            return y * y

        return sum([square(x + k) for k in range(3)])

    used = as_device(total)

    @kernel
    def call(x):
        return used(x)

    assert call(2) == 4 + 9 + 16
