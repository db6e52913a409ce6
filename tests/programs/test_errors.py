import re
import weakref

import numpy as np
import pytest

import raystream as rs
from conftest import tier
from meshes import cube, soup
from raystream.jit import threads
from raystream.machines import branching
from raystream.machines.backend import Capabilities
from raystream.programs.program import Program

RAY = ([0.3, 0.4, -2.0], [0.0, 0.0, 1.0])
GLOBAL = {"a": 1}


#: Those of the BVH; a default run has the one that most rays are traced by.
KERNELS = [
    pytest.param(kernel, marks=tier(is_everyday=kernel == "wavefront"))
    for kernel in ("wavefront", "packet", "groups", "single")
]


@pytest.fixture(scope="module")
def tracer():
    return rs.Tracer(rs.Scene.from_arrays(*cube()))


def count(hit, payload):
    payload[0] += 1


def misspelt(hit, payload):
    payload[0] = hit.prim


def seven(hit, payload):
    return 7


def truth(hit, payload):
    return True


def number(hit):
    return 0.5


def mixed(hit):
    if hit.t > 1:
        return True
    return rs.Decision.IGNORE


def one_argument(hit):
    return True


def of_dict(hit, payload):
    payload[0] = GLOBAL["a"]


def wrong_field(hit, payload):
    payload.weight += 1


def raises(hit, payload):
    if hit.t > 0:
        raise KeyError("no such thing")


def raises_nothing(hit):
    if hit.t > 0:
        raise ValueError
    return True


def raises_type_error(hit, payload):
    if hit.t > 0:
        raise TypeError("mine")


@pytest.mark.parametrize(
    ("function", "payload", "message"),
    [
        (misspelt, int, "misspelt: Numba cannot compile it: .*prim.*test_errors.py"),
        (seven, int, "seven: it returns int64; expected one of CONTINUE, STOP, IGNORE, or None"),
        (truth, int, "truth: it returns .*; expected one of CONTINUE"),
        (one_argument, int, re.escape("one_argument: takes (hit); expected (hit, payload)")),
        (of_dict, int, "of_dict: Numba cannot compile it"),
        (wrong_field, [("mass", float)], "wrong_field: Numba cannot compile it: .*weight"),
        (count, None, "count: Numba cannot compile it"),
        (len, int, "on_hit: expected a Python function, got builtin_function_or_method"),
        (None, int, "on_hit: expected a Python function, got NoneType"),
        (count, 3, "payload: expected a writable NumPy array or a dtype, got 3"),
        (count, "f2", "payload: programs cannot compute with dtype float16"),
        (count, object, "payload: programs cannot compute with dtype object"),
        (count, [("a", "U4")], "payload: programs cannot compute with dtype <U4"),
        (count, ">f8", "payload: programs cannot compute with dtype >f8"),
    ],
)
def test_what_cannot_be_a_program(tracer, function, payload, message):
    with pytest.raises(TypeError, match=f"^{message}"):
        tracer.trace(*RAY, on_hit=function, payload=payload)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (count, re.escape("count: takes (hit, payload); expected (hit)")),
        (number, "number: it returns float64; expected one of True, False, CONTINUE"),
        (mixed, "mixed: Numba cannot compile it: .*unify"),
    ],
)
def test_what_cannot_be_a_filter(tracer, function, message):
    for query in (tracer.first_hit, tracer.any_hit, tracer.count_hits, tracer.multi_hit):
        with pytest.raises(TypeError, match=f"^{message}"):
            query(*RAY, on_hit=function)


@pytest.mark.parametrize(
    ("function", "message", "cause"),
    [
        (raises, "raises: raised KeyError: 'no such thing'", KeyError),
        (raises_type_error, "raises_type_error: raised TypeError: mine", TypeError),
    ],
)
def test_what_a_program_raises_names_it(tracer, function, message, cause):
    with pytest.raises(RuntimeError, match=f"^{message}$") as caught:
        tracer.trace(*RAY, on_hit=function, payload=int)
    assert isinstance(caught.value.__cause__, cause)


def test_what_a_filter_raises_names_it(tracer):
    with pytest.raises(RuntimeError, match=r"^raises_nothing: raised ValueError$"):
        tracer.first_hit(*RAY, on_hit=raises_nothing)


def raises_behind(hit):
    if hit.t > 2.5:
        raise ValueError("behind")
    return True


def raises_in_front(hit):
    if hit.t < 2.5:
        raise ValueError("in front")
    return False


@pytest.mark.parametrize("kernel", KERNELS)
def test_a_filter_raises_only_at_the_nearest_hits(kernel):
    """Whatever other hits a traversal finds, and in what order."""
    tracer = rs.Tracer(rs.Scene.from_arrays(*cube()), kernel=kernel)
    rays = np.zeros((40, 3)) + RAY[0], RAY[1]
    expected = tracer.first_hit(*rays)
    assert (expected.t == 2.0).all()
    for is_from_behind in (False, True):
        toward = [0.0, 0.0, -1.0 if is_from_behind else 1.0]
        origins = rays[0] + [0.0, 0.0, 5.0 if is_from_behind else 0.0]
        hits = tracer.first_hit(origins, toward, on_hit=raises_behind)
        assert (hits.t == 2.0).all()
        assert tracer.any_hit(origins, toward, on_hit=raises_behind).all()
        for query in (tracer.first_hit, tracer.any_hit):
            with pytest.raises(RuntimeError, match=r"^raises_in_front: raised ValueError: in"):
                query(origins, toward, on_hit=raises_in_front)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("query", ["first_hit", "any_hit"])
def test_progress_never_decreases_when_a_filter_raises(kernel, query, monkeypatch):
    """Though the rays are traced again then, over their nearest hits."""
    monkeypatch.setattr(threads, "PROGRESS_INTERVAL", 0.0)
    tracer = rs.Tracer(rs.Scene.from_arrays(*cube()), kernel=kernel)
    origins = np.zeros((40_000, 3)) + RAY[0]
    reports = []

    def progress(done, total):
        reports.append(done / total)

    with pytest.raises(RuntimeError, match="in front"):
        getattr(tracer, query)(origins, RAY[1], on_hit=raises_in_front, progress=progress)
    assert len(reports) > 1
    assert reports == sorted(reports)


def ends_first(hit):
    return rs.Decision.STOP if hit.t < 2.5 else rs.Decision.CONTINUE


@pytest.mark.ci
def test_progress_never_decreases_when_hits_are_counted_again(monkeypatch):
    monkeypatch.setattr(threads, "PROGRESS_INTERVAL", 0.0)
    tracer = rs.Tracer(rs.Scene.from_arrays(*cube()))
    reports = []
    origins = np.zeros((40_000, 3)) + RAY[0]
    tracer.count_hits(
        origins,
        RAY[1],
        on_hit=ends_first,
        progress=lambda done, total: reports.append(done / total),
    )
    assert reports == sorted(reports)


def starts_inside(hit):
    return hit.is_entering


def note_entering(hit, payload):
    payload[0] = hit.is_entering


@pytest.mark.parametrize("query", ["first_hit", "any_hit", "count_hits", "trace"])
def test_triangles_stay_while_programs_read_them(query, monkeypatch):
    """Another tracer of the scene frees the corners, in another thread or in a callback."""
    tracer = rs.Tracer(rs.Scene.from_arrays(*soup(20_000)))
    triangles = tracer.structure.triangles
    corners, trace_batch, alive = weakref.ref(triangles.corners), branching.trace_batch, []

    def trace_after_release(*arguments):
        triangles.release()
        alive.append(corners() is not None)
        return trace_batch(*arguments)

    monkeypatch.setattr(branching, "trace_batch", trace_after_release)
    origins = np.zeros((500, 3))
    if query == "trace":
        tracer.trace(origins, RAY[1], on_hit=note_entering, payload=np.zeros((500, 1)))
    else:
        getattr(tracer, query)(origins, RAY[1], on_hit=starts_inside)
    assert alive
    assert all(alive)


def test_shapes_and_names(tracer):
    rays = np.zeros((4, 3)) + [0.3, 0.4, -2.0], [0.0, 0.0, 1.0]
    with pytest.raises(ValueError, match=r"^payload: expected the rays' shape \(4,\), or .*\(5,"):
        tracer.trace(*rays, on_hit=count, payload=np.zeros(5))
    with pytest.raises(ValueError, match=r"shape \(4,\), got \(4, 2\)"):
        tracer.trace(*rays, on_hit=count, payload=np.zeros((4, 2), [("a", "f8")]))
    with pytest.raises(ValueError, match=r"got \(4, 2, 2\)"):
        tracer.trace(*rays, on_hit=count, payload=np.dtype(("f8", (2, 2))))
    with pytest.raises(ValueError, match=r"^payload: the array is read-only"):
        tracer.trace(*rays, on_hit=count, payload=np.broadcast_to(0.0, 4))
    with pytest.raises(ValueError, match=r"^order: expected 'front-to-back' or 'any', got 'back'"):
        tracer.trace(*rays, on_hit=count, payload=int, order="back")
    with pytest.raises(ValueError, match=r"^crossings: expected"):
        tracer.trace(*rays, on_hit=count, payload=int, crossings="lines")
    with pytest.raises(ValueError, match=r"^skip_prim_ids: expected the rays' shape \(4,\)"):
        tracer.first_hit(*rays, skip_prim_ids=[1, 2])
    with pytest.raises(ValueError, match=r"^skip_prim_ids: expected -1 or a prim_id below 12"):
        tracer.first_hit(*rays, skip_prim_ids=[1, 2, 12, -1])
    with pytest.raises(TypeError, match=r"^skip_prim_ids: expected integers"):
        tracer.first_hit(*rays, skip_prim_ids=[1.0, 2.0, 3.0, -1.0])


def test_tracers_that_cannot():
    scene = rs.Scene.from_arrays(*cube())
    counting = rs.Tracer(scene, counters=True)
    with pytest.raises(ValueError, match=r"^on_hit, skip_prim_ids: a tracer with counters"):
        counting.trace(*RAY, on_hit=count, payload=int)
    with pytest.raises(ValueError, match=r"^on_hit, skip_prim_ids: a tracer with counters"):
        counting.first_hit(*RAY, skip_prim_ids=-1)
    elsewhere = rs.Tracer(scene)
    elsewhere._backend.capabilities = Capabilities(programs=False)  # as another device's may be
    with pytest.raises(ValueError, match="programs do not run on this tracer's device"):
        elsewhere.count_hits(*RAY, on_hit=one_argument)


def test_an_interrupt_ends_a_trace(tracer, monkeypatch):
    def interrupted(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr(Program, "run", interrupted)
    with pytest.raises(KeyboardInterrupt):
        tracer.trace(*RAY, on_hit=count, payload=int)
