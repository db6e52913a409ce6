"""Renderers whose stages stay on the device: the CPU's bits, without copies to the host."""

from __future__ import annotations

import numpy as np
import pytest

from extras import need

need("numba_cuda")

import raystream as rs
from conftest import assert_same_bits
from dark_views import DARK_VIEWS
from meshes import cube, icosphere
from raystream.core.errors import RaystreamError
from raystream.cuda.rendering.tables import TableMemory
from raystream.cuda.staging import StagingStream
from raystream.jit.cuda import CudaError, Gpu, is_simulated
from raystream.jit.cuda.arguments import flat, kind_of
from raystream.rendering.contexts import make_context
from raystream.rendering.render import RENDERERS
from raystream.rendering.sampling.sampler import Sampler
from raystream.rendering.shading.keep_alive import kept_arrays
from raystream.rendering.shading.light_tables import LightTables, lights_of
from raystream.rendering.shading.tables import SceneTables, tables_of
from raystream.structures import names_with
from raystream_lab.recording_tracer import RecordingTracer

#: Images with sines, powers and exponentials in float64, which a GPU may round differently.
ROUNDED = () if is_simulated() else ("image", "raycast", "shadow")

RANDOM = np.random.default_rng(9)


def bitmap(*shape: int, **options) -> rs.Texture:
    return rs.Texture(RANDOM.integers(0, 256, (*shape, 3), np.uint8), **options)


MATERIALS = [
    rs.Material(
        "floor",
        diffuse=(0.8, 0.7, 0.6),
        textures={
            "diffuse": bitmap(
                4, 8, wrap=("mirror", "clamp"), transform=(0.5, -0.7, 0.1, 0.8, 0.4, -0.3)
            )
        },
    ),
    rs.Material("lamp", diffuse=(0.2, 0.2, 0.2), emission=(4.0, 3.0, 2.0)),
    rs.Material("gloss", diffuse=(0.3, 0.3, 0.1), specular=(0.4, 0.4, 0.6), shininess=30.0),
    rs.Material(
        "glass", diffuse=(0, 0, 0), transmission=(1, 1, 1), ior=1.5, absorption=(0.2, 2.0, 3.0)
    ),
    rs.Material(
        "metal",
        diffuse=(0.9, 0.7, 0.4),
        roughness=0.4,
        metallic=0.7,
        normal_reflectance=(0.1, 0.05, 0.02),
        grazing_reflectance=0.75,
        transmission=(0.3, 0.2, 0.1),
        clearcoat=0.7,
        clearcoat_roughness=0.5,
        sheen_color=(0.2, 0.5, 0.3),
        sheen_roughness=0.6,
        textures={
            "clearcoat_normal": rs.Texture(np.uint8([[[120, 150, 240]]])),
            "sheen_roughness": bitmap(2, 2),
            "normal": rs.Texture(np.uint8([[[150, 110, 240], [110, 140, 240]]])),
            "metallic_roughness": bitmap(2, 2),
        },
    ),
]
FLOOR, LAMP, GLOSS, GLASS, METAL = range(5)


def part(shape, material_id, scale=1.0, at=(0.0, 0.0, 0.0), **attributes):
    vertices, faces = shape
    places = vertices * np.asarray(scale) + at
    return rs.Mesh(places, faces, material_ids=material_id, **attributes)


def square(low, high, height):
    corners = [[low, height, low], [high, height, low], [high, height, high], [low, height, high]]
    return np.array(corners), np.array([[0, 1, 2], [0, 2, 3]])


def room(**options) -> rs.Scene:
    """A floor under a lamp, with glass, gloss and bumpy metal on it: every kind of material."""
    ball = icosphere(1)
    box = cube()
    floor = square(-2.0, 3.0, 0.0)
    meshes = [
        part((floor[0], floor[1][:, ::-1]), FLOOR, texcoords=floor[0][:, [0, 2]]),
        part(square(0.2, 0.8, 1.4), LAMP),
        part(ball, GLASS, 0.25, (0.3, 0.26, 0.8), normals=ball[0]),
        part(ball, METAL, 0.25, (0.8, 0.26, 0.3), normals=ball[0], texcoords=ball[0][:, :2]),
        part(box, GLOSS, 0.3, (-0.1, 0.01, 0.1), colors=np.abs(box[0]) * 0.5 + 0.3),
    ]
    usual = {
        "lights": [
            rs.PointLight((0.5, 1.0, 2.0), (1.0, 0.8, 0.6)),
            rs.SpotLight((0.3, 1.2, 0.9), (0.1, -1.0, 0.0), (0.9, 0.7, 0.4), 5.0, 35.0),
            rs.DirectionalLight((0.3, -1.0, -0.2), (0.5, 0.5, 0.9)),
            rs.EnvironmentLight((0.2, 0.4, 0.8)),
        ],
        "camera": rs.Camera((0.5, 0.7, 2.2), (0.45, 0.3, 0.3), fov=45),
    }
    return rs.Scene(meshes, **{"materials": MATERIALS, **usual, **options})


IMAGE = rs.EnvironmentLight((0.5, 0.5, 0.5), RANDOM.random((4, 8, 3)).astype(np.float32))
LENS = rs.Camera((0.5, 0.7, 2.2), (0.45, 0.3, 0.3), fov=45, aperture=0.1, focus=1.8)
AROUND = rs.Camera((0.5, 0.7, 1.5), (0.45, 0.3, 0.3), projection="equirectangular")

#: Mode, options, and special features of the scene.
PICTURES = {
    "path": ("path", {"max_bounces": 4}, {}),
    "kajiya": ("kajiya", {"samples": 2, "sampler": "stratified"}, {}),
    "by chance": ("path", {"light_samples": False, "sampler": "random", "clamp": 0.7}, {}),
    "image": ("path", {"samples": 2, "max_bounces": 2}, {"lights": [IMAGE]}),
    "lens": ("path", {"samples": 2, "max_bounces": 1}, {"camera": LENS}),
    "panorama": ("path", {"max_bounces": 1}, {"camera": AROUND}),
    "emitted": ("path", {"max_bounces": 0}, {"lights": [], "background": (0.3, 0.2, 0.1)}),
    "raycast": ("raycast", {}, {}),
    "vis": ("vis", {"samples": 2}, {}),
    "shadow": ("shadow", {}, {}),
    "ao": ("ao", {"rays": 5, "distance": 1.0}, {}),
}


def render(device, mode, options, special, size=(7, 6)):
    tracer = rs.Tracer(room(**special), "brute", device)
    return rs.render(tracer, mode, size, **{"samples": 1, **options})


@pytest.mark.parametrize("name", PICTURES)
def test_pictures_are_the_processor_s(gpu, name):
    ours, theirs = (render(device, *PICTURES[name]).pixels for device in ("cuda", "cpu"))
    assert theirs.std() > 0.0
    if name in ROUNDED:
        assert np.isclose(ours, theirs, rtol=1e-3, atol=1e-4).mean() > 0.95
    else:
        assert_same_bits(ours, theirs)


@pytest.mark.filterwarnings("ignore:the scene's own lights")
@pytest.mark.parametrize(
    ("name", "structure", "build"),
    [
        *((name, "bvh", "host") for name in DARK_VIEWS),
        *(("closed_room", structure, "device") for structure in names_with("cuda build")),
    ],
)
def test_dark_views_get_the_processor_s_lights_by_default(gpu, name, structure, build):
    """Also with a structure that is on the device only."""
    scene = DARK_VIEWS[name]()
    ours, theirs = (
        rs.render(rs.Tracer(scene, structure, device), "shadow", (7, 6)).pixels
        for device in (rs.Cuda(build=build), "cpu")
    )
    assert np.median(theirs) > 0.01
    assert_same_bits(ours, theirs)


@pytest.fixture
def travels(monkeypatch):
    """Bytes of each copy between host and device through staging_streams."""
    sizes = {"upload": [], "download": []}
    upload, download = StagingStream.upload, StagingStream.download

    def counted_upload(staging, name, array):
        sizes["upload"].append(array.nbytes)
        return upload(staging, name, array)

    def counted_download(staging, array):
        sizes["download"].append(array.nbytes)
        return download(staging, array)

    monkeypatch.setattr(StagingStream, "upload", counted_upload)
    monkeypatch.setattr(StagingStream, "download", counted_download)
    return sizes


def test_nothing_but_counts_and_light_travels(gpu, travels, monkeypatch):
    tracer = rs.Tracer(room(), "brute", "cuda")
    monkeypatch.setattr(tracer._backend, "run", None)  # of rays on the host
    width, height, bounces = 5, 4, 3
    rs.render(tracer, "path", (width, height), 1, max_bounces=bounces)
    assert travels["upload"] == []
    # The first of them is row 0 alone, which compiles. Two counts for each surface but the last.
    light = [size for size in travels["download"] if size != 4]
    assert light == [12 * width, 12 * width * height]
    assert len(travels["download"]) - len(light) <= 2 * 2 * bounces


def test_tables_are_copied_once(gpu, monkeypatch):
    names = []
    upload = Gpu.upload
    monkeypatch.setattr(
        Gpu, "upload", lambda own, name, array: names.append(name) or upload(own, name, array)
    )
    tracer = rs.Tracer(room(), "brute", "cuda")
    names.clear()
    rs.render(tracer, "path", (2, 2), 3, max_bounces=1)
    assert names
    assert len(names) == len(set(names))
    assert all(name.startswith("the scene's") for name in names)


def test_what_the_device_has_no_stages_for_is_the_host_s(gpu):
    def is_taken(scene, mode="path", layers=()):
        tracer, renderer = rs.Tracer(scene, "brute", "cuda"), RENDERERS[mode]
        options, usual = renderer.check(renderer.options), Sampler.of("sobol")
        context = make_context(tracer, scene.camera, (2, 2), usual, options, layers)
        return renderer.bands_of(context) is not None

    clear = rs.Material("clear", diffuse=(0.5, 0.5, 0.5), opacity=0.5)
    assert [mode for mode in RENDERERS if not is_taken(room(), mode)] == ["whitted", "xray"]
    assert not is_taken(room(), layers=["depth"])
    assert not is_taken(room(materials=[clear, *MATERIALS[1:]]))


def test_layers_change_no_light(gpu):
    tracer = rs.Tracer(room(), "brute", "cuda")
    options = {"size": (3, 2), "samples": 1, "max_bounces": 1}
    layered = rs.render(tracer, "path", layers=["depth"], **options)
    assert np.isfinite(layered.layers["depth"]).any()
    assert_same_bits(layered.pixels, rs.render(tracer, "path", **options).pixels)


def test_a_break_does_not_show(gpu, tmp_path):
    tracer = rs.Tracer(room(), "brute", "cuda")
    file = tmp_path / "picture.npz"
    options = {"size": (3, 2), "max_bounces": 1, "samples": 3}

    def stop(done, total):
        assert total == 3 * 2 * 3
        if done == 3 * 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rs.render(tracer, "path", checkpoint=file, progress=stop, **options)
    again = rs.render(tracer, "path", checkpoint=file, **options)
    assert_same_bits(again.pixels, rs.render(tracer, "path", **options).pixels)


def test_bands_do_not_show(gpu):
    scene, options = room(), {"size": (3, 4), "samples": 1, "max_bounces": 2}
    few, many = (
        rs.render(rs.Tracer(scene, "brute", "cuda", rays_at_once=count), "path", **options)
        for count in (3, 4096)
    )
    assert_same_bits(few.pixels, many.pixels)


# Tables


def host_of(address: np.uint64, like: np.ndarray, memory: TableMemory) -> np.ndarray:
    """The bytes copied to an address."""
    (array,) = (one for one in memory.arrays.values() if one.address == address)
    return array.host().view(like.dtype).reshape(like.shape)


def test_tables_point_to_copies(gpu):
    scene = room(lights=[IMAGE])
    tables, kept = tables_of(scene)
    memory = TableMemory(gpu, kept)
    placed = memory.placed(tables)
    assert type(placed) is SceneTables
    corners = np.ascontiguousarray(scene.triangles.corners)
    assert_same_bits(host_of(placed.corners, corners, memory), corners)
    # Within one array.
    apart = placed.mirrored_tangents - placed.tangents
    assert apart == tables.mirrored_tangents - tables.tangents > 0
    assert placed.kinds == tables.kinds
    assert placed.kinds == tables.kinds


def test_addresses_in_tables_are_changed_too(gpu):
    lights, kept = lights_of(room(lights=[IMAGE]))
    memory = TableMemory(gpu, kept)
    placed = memory.placed(lights)
    assert type(placed) is LightTables
    assert placed.prim_count == lights.prim_count == 2  # counts are no addresses
    numbers = host_of(placed.sky.image, np.empty(17, np.uint64), memory)
    assert numbers[:2].tolist() == [8, 4]
    texels = np.ascontiguousarray(IMAGE.image)
    assert_same_bits(host_of(numbers[2], texels, memory), texels)
    assert {int(numbers[k]) for k in (2, 3, 4)} <= {
        int(one.address) for one in memory.arrays.values()
    }


def test_what_is_not_kept_is_an_error(gpu):
    tables, kept = tables_of(room())
    with pytest.raises(LookupError, match="corners: nothing is kept at its address"):
        TableMemory(gpu, ()).placed(tables)
    with pytest.raises(TypeError, match="expected arrays in tuples, got list"):
        list(kept_arrays((kept, [1])))


def test_a_scene_too_large_for_the_memory(gpu, monkeypatch):
    tracer = rs.Tracer(room(), "brute", "cuda")
    monkeypatch.setattr(Gpu, "free_byte_count", lambda _: 100)
    with pytest.raises(CudaError, match=r"the scene's \w+ take [\d,]+ bytes, but .* has 100 free"):
        rs.render(tracer, "path", (2, 2), 1)
    assert issubclass(CudaError, RaystreamError)


def test_numbers_are_passed_as_numpy_s(gpu):
    """Sizes of a launch's values are those of the types that a kernel is compiled for."""
    given = Sampler.of("sobol", 7, 2), (True, 1.5, (2**63, gpu.empty("one", 1, np.int8)), None)
    types = [np.int64] * 3 + [np.uint8, np.float64, np.uint64, np.uint64, np.uint64]
    assert [type(one) for one in flat(given)] == types
    signed, (_, _, unsigned, _) = kind_of(given)[1], kind_of(given)[2][1:]
    assert signed == (Sampler, *[np.int64] * 3)
    assert unsigned == (tuple, np.uint64, np.uint64)


def test_other_tracers_shade_on_the_host(gpu):
    scene = room()
    usual = Sampler.of("sobol")
    on_cpu = rs.Tracer(scene, "brute")
    counting = rs.Tracer(scene, "brute", "cuda", counters=True)
    noting = RecordingTracer(scene, "brute", device="cuda")
    for tracer in (on_cpu, counting, noting):
        assert make_context(tracer, scene.camera, (2, 2), usual, {}).bands is None
