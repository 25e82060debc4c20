"""Target models: levels by aspect, echo points in the world, USD attributes and name rule, the radar equation."""

import numpy as np
import pytest
from usd_files import read

from datafactory.frame.points import PointTargets
from datafactory.paths.echo_points import EchoPoints, Seen, all_echo_points
from datafactory.paths.table import PathTable, ScatteredPaths
from datafactory.scenes.readers.open import open_scene
from datafactory.scenes.scene import PointTarget
from datafactory.scenes.targets.bodies import Cylinder, Dihedral, Plate, Sphere, Trihedral
from datafactory.scenes.targets.models import MODELS, Car, Cyclist, Pedestrian, sizes_of, target_model
from datafactory.synthesis.cube import cube_of_paths
from shared.physics import rcs
from shared.radar import Radar
from shared.signal.spectrum import range_doppler

WAVELENGTH = 3.868e-3


def echo_points(targets, radar_position, wavelength_m: float, cross_polarized: bool = False) -> EchoPoints:
    """The echo points that are heard."""
    return all_echo_points(targets, radar_position, Seen(wavelength_m, cross_polarized=cross_polarized)).heard()


def direction(azimuth_deg: float, zenith_deg: float) -> np.ndarray:
    azimuth, zenith = np.radians([azimuth_deg, zenith_deg])
    return np.array([np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), np.cos(zenith)])


def total_dbsm(model, azimuth_deg: float, zenith_deg: float = 90.0) -> float:
    """Sum of the cross sections, seen from so far away that all points see the radar in one direction."""
    return 10.0 * np.log10(model.echoes(1e7 * direction(azimuth_deg, zenith_deg), WAVELENGTH)[1].sum())


@pytest.mark.parametrize(
    ("azimuth_deg", "zenith_deg", "rcs_dbsm"),
    [(0.0, 71.75, 15.5), (90.0, 79.7, 20.8), (270.0, 79.7, 20.8), (180.0, 79.65, 14.6), (10.0, 0.0, 21.2)],
)
def test_a_car_shows_the_levels_of_tr_38901(azimuth_deg, zenith_deg, rcs_dbsm):
    assert total_dbsm(Car(), azimuth_deg, zenith_deg) == pytest.approx(rcs_dbsm, abs=0.07)


def test_a_cars_points_are_those_of_another_implementation(variant):
    """Every lobe over the sphere against Sionna RT's, in float32."""
    import mitsuba as mi
    from sionna.rt.rcs.tr38901 import TR38901RCS, get_target_parameters

    theirs = {lobe.name: lobe for lobe in get_target_parameters("vehicle-multi-sp", 2).lobes}
    towards = np.random.default_rng(4).normal(size=(200, 3))
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    ours = np.array([Car().echoes(1e7 * direction, WAVELENGTH)[1] for direction in towards])
    outward = mi.Vector3f(*towards.T.astype(np.float32))
    for column, name in enumerate(("left", "back", "right", "front", "roof")):
        expected = TR38901RCS([theirs[name]])(-outward, outward).numpy()
        np.testing.assert_allclose(10.0 * np.log10(ours[:, column] / expected), 0.0, atol=2e-3)


def test_pedestrian_and_cyclist():
    for azimuth in (0.0, 77.0, 180.0):
        assert total_dbsm(Pedestrian(), azimuth) == pytest.approx(-1.4, abs=0.05)
    assert total_dbsm(Cyclist(), 90.0) == pytest.approx(-8.0, abs=1e-3)
    assert total_dbsm(Cyclist(), 180.0) == pytest.approx(-13.0, abs=1e-3)
    mean = np.mean([10.0 ** (total_dbsm(Cyclist(), azimuth) / 10.0) for azimuth in np.arange(0.0, 360.0, 10.0)])
    assert 10.0 * np.log10(mean) == pytest.approx(Cyclist.nominal_rcs_dbsm, abs=0.05)


def test_bodies_are_their_formulas():
    ahead = np.array([1e5, 0.0, 0.0])
    for model, expected, echo in (
        (Sphere(0.1), rcs.sphere_rcs_m2(0.1), [0.1, 0.0, 0.0]),
        (Cylinder(0.05, 0.4), rcs.cylinder_rcs_m2(0.05, 0.4, WAVELENGTH), [0.05, 0.0, 0.0]),
        (Plate(0.2, 0.1), rcs.plate_rcs_m2(0.2, 0.1, WAVELENGTH), [0.0, 0.0, 0.0]),
        (Dihedral(0.1, 0.2), rcs.dihedral_rcs_m2(0.1, 0.2, WAVELENGTH), [0.0, 0.0, 0.0]),
        (Trihedral(0.1), rcs.trihedral_rcs_m2(0.1, WAVELENGTH), [0.0, 0.0, 0.0]),
    ):
        points, sections = model.echoes(ahead, WAVELENGTH)
        np.testing.assert_allclose(sections, np.array([expected]), rtol=1e-6)
        np.testing.assert_allclose(points, [echo], atol=1e-12)
        assert model.nominal_rcs_dbsm == pytest.approx(10.0 * np.log10(expected), abs=0.1)


def test_corners_are_silent_from_behind_and_a_plate_is_not():
    behind = np.array([-50.0, 0.0, 0.0])
    assert Trihedral(0.1).echoes(behind, WAVELENGTH)[1].tolist() == [0.0]
    assert Dihedral(0.1, 0.1).echoes(behind, WAVELENGTH)[1].tolist() == [0.0]
    assert Plate(0.1, 0.1).echoes(behind, WAVELENGTH)[1] == pytest.approx(rcs.plate_rcs_m2(0.1, 0.1, WAVELENGTH).item())


@pytest.mark.parametrize("kind", MODELS)
def test_every_model_is_finite_from_everywhere(kind):
    model = target_model(kind, dict.fromkeys(sizes_of(kind), 0.2))
    for zenith in (0.0, 45.0, 90.0, 180.0):
        for azimuth in (-180.0, -90.0, 0.0, 33.0, 90.0):
            points, sections = model.echoes(5.0 * direction(azimuth, zenith), WAVELENGTH)
            assert points.shape == (len(sections), 3)
            assert np.isfinite(points).all()
            assert np.isfinite(sections).all()
            assert (sections >= 0.0).all()


def test_echo_points_stand_and_move_with_their_target():
    # A car heading for +y (its left is -x), 2 s after the start; the radar looks at its left side.
    axes = ((0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    car = PointTarget("car", (10.0, -4.0, 0.0), 11.25, (0.0, 2.0, 0.0), Car(), axes)
    post = PointTarget("post", (3.0, 1.0, 0.5), -7.0)
    echoes = echo_points([post.at(2.0), car.at(2.0)], (0.0, 0.0, 0.5), WAVELENGTH)
    assert echoes.target.tolist() == [0, 1, 1, 1, 1, 1]
    assert echoes.rcs_m2[0] == pytest.approx(10.0**-0.7)
    np.testing.assert_allclose(echoes.position[0], [3.0, 1.0, 0.5])
    strongest = 1 + int(np.argmax(echoes.rcs_m2[1:]))
    np.testing.assert_allclose(echoes.position[strongest], [9.0, 0.0, 0.8])
    np.testing.assert_allclose(echoes.velocity[strongest], [0.0, 2.0, 0.0])
    np.testing.assert_allclose(echoes.position[4], [10.0, 2.5, 0.8])  # the front, 2.5 m ahead


def test_cross_polarisation_weakens_people_and_silences_metal():
    targets = [PointTarget("p", (9.0, 0.0, 0.0), 0.0, model=Pedestrian()), PointTarget("x", (9.0, 1.0, 0.0), 3.0)]
    metal = PointTarget("s", (9.0, 2.0, 0.0), 0.0, model=Sphere(0.1))
    plain = echo_points([*targets, metal], (0.0, 0.0, 0.0), WAVELENGTH)
    crossed = echo_points([*targets, metal], (0.0, 0.0, 0.0), WAVELENGTH, cross_polarized=True)
    assert (plain.silent, crossed.silent) == (0, 1)
    assert crossed.target.tolist() == [0, 1]
    np.testing.assert_allclose(10.0 * np.log10(plain.rcs_m2[:2] / crossed.rcs_m2), [19.81, 0.0], atol=1e-9)


def test_targets_within_their_far_field_are_counted():
    corner = Trihedral(0.2)
    far = corner.far_field_m(WAVELENGTH)
    assert far == pytest.approx(2.0 * 2.0 * 0.2**2 / WAVELENGTH)
    axes = ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))  # open towards the radar
    for distance, near in ((0.9 * far, 1), (1.1 * far, 0)):
        target = PointTarget("corner", (distance, 0.0, 0.0), 0.0, model=corner, axes=axes)
        assert echo_points([target], (0.0, 0.0, 0.0), WAVELENGTH).near == near


def echo_power_db(table: PathTable, radar: Radar) -> float:
    """Peak of the mean magnitude over channels: what an on-grid target reads in the range-Doppler map."""
    spectra = range_doppler(cube_of_paths(table, radar, 1e-6).astype(np.complex64), radar)
    return float(20.0 * np.log10(np.abs(spectra).max()))


@pytest.mark.parametrize("model", [None, Sphere(0.3), Trihedral(0.1), Cylinder(0.05, 0.2)])
def test_targets_obey_the_radar_equation_end_to_end(small_radar, model):
    radar = small_radar(samples=128, chirps=4)
    wavelength, bin_m = radar.waveform.wavelength_m, radar.waveform.range_step_m
    echo = np.array([60 * bin_m, 0.0, 0.0])  # on the grid of ranges, at boresight
    axes = ((-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0))
    offset = 0.0 if model is None else model.echoes(np.array([1.0, 0.0, 0.0]), wavelength)[0][0, 0]
    target = PointTarget("t", (echo[0] + offset, 0.0, 0.0), 4.0, model=model, axes=axes)
    echoes = echo_points([target], (0.0, 0.0, 0.0), wavelength)
    np.testing.assert_allclose(echoes.position, [echo], atol=1e-12)
    amplitude = wavelength * np.sqrt(echoes.rcs_m2) / (4.0 * np.pi) ** 1.5 / 60.0**2 / bin_m**2
    table = PathTable(ScatteredPaths.of_points(echoes.position, echoes.velocity, amplitude))
    level = echo_power_db(table.illuminated(radar.front_end), radar)
    sigma = {
        "NoneType": 4.0,
        "Sphere": 10.0 * np.log10(np.pi * 0.3**2),
        "Trihedral": 10.0 * np.log10(4.0 * np.pi * 0.1**4 / 3.0 / wavelength**2),
        "Cylinder": 10.0 * np.log10(2.0 * np.pi * 0.05 * 0.2**2 / wavelength),
    }[type(model).__name__]
    # P_t G^2 lambda^2 sigma / ((4 pi)^3 R^4) in dBW: 10 dBm, 2 x 11.1 dBi.
    expected = -20.0 + 22.2 + 20.0 * np.log10(wavelength) + sigma - 30.0 * np.log10(4.0 * np.pi)
    expected -= 40.0 * np.log10(60 * bin_m)
    assert level == pytest.approx(expected, abs=0.01)
    same = PointTargets(echo[None, :], np.zeros((1, 3)), np.array([sigma]), np.zeros(1)).path_table(radar)
    assert echo_power_db(same, radar) == pytest.approx(level, abs=0.01)


TURNED = 'double xformOp:rotateZ = 90\n uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]'


def test_the_target_attribute_calls_for_a_model_and_gives_it_the_prims_heading(tmp_path):
    scene = read(
        tmp_path,
        f"""def Xform "taxi" {{
            custom token radar:target = "car"
            custom double3 radar:velocity = (0, 3, 0)
            double3 xformOp:translate = (5, 1, 0)
            {TURNED}
            def Cube "body" {{ }}
        }}
        def Xform "corner" {{
            custom string radar:target = "trihedral"
            custom double radar:edge_m = 0.15
        }}""",
    )
    car, corner = scene.targets
    assert (car.name, car.model, car.position, car.velocity) == ("/taxi", Car(), (5.0, 1.0, 0.0), (0.0, 3.0, 0.0))
    np.testing.assert_allclose(car.axes, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-12)
    assert corner.model == Trihedral(0.15)
    assert scene.warnings == ("1 geometry prims left out: the model of a target stands for them",)
    assert scene.content_hash() == open_scene(str(tmp_path / "stage.usda")).content_hash()


def test_radar_attributes_that_nothing_reads_are_counted_and_told(tmp_path):
    scene = read(
        tmp_path,
        """def Xform "pole" {
            custom double radar:rcs_dbs = 3
            def Cube "a" {
                custom string radar:colour = "red"
            }
            def Cube "b" {
                custom string radar:colour = "red"
            }
        }
        def Cube "c" {
            custom string radar:class = "car"
            custom float radar:stature_m = 1.8
        }
        def Xform "walker" {
            custom string radar:target = "pedestrian"
            custom float radar:stature_m = 1.8
        }""",
    )
    assert set(scene.warnings) == {
        "1 attributes radar:rcs_dbs ignored: there is no such name; did you mean 'rcs_dbsm'?",
        "2 attributes radar:colour ignored: there is no such name",
        "1 attributes radar:stature_m ignored: their prim is no radar:target that has a model",
    }


def test_units_and_up_axis_turn_the_frame_and_leave_the_size(tmp_path):
    # Y up: forward is the prim's x, up its y. The prim heads for the stage's -z, which is the world's +y.
    body = """def Xform "post" {
        custom string radar:target = "cylinder"
        custom float radar:radius_m = 0.1
        custom float radar:length_m = 1
        double3 xformOp:translate = (200, 50, -100)
        double xformOp:rotateY = 90
        float3 xformOp:scale = (3, 3, 3)
        uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateY", "xformOp:scale"]
    }"""
    (post,) = read(tmp_path, body, 'metersPerUnit = 0.01\n upAxis = "Y"').targets
    assert post.position == pytest.approx((2.0, 1.0, 0.5))
    np.testing.assert_allclose(post.axes, [[0, 1, 0], [-1, 0, 0], [0, 0, 1]], atol=1e-12)
    assert isinstance(post.model, Cylinder)
    assert post.model.length_m == 1.0


def test_a_mirror_leaves_a_right_handed_frame(tmp_path):
    body = """def Xform "c" {
        custom string radar:target = "car"
        float3 xformOp:scale = (1, -1, 1)
        uniform token[] xformOpOrder = ["xformOp:scale"]
    }"""
    (car,) = read(tmp_path, body).targets
    assert np.linalg.det(np.array(car.axes)) == pytest.approx(1.0)


def test_the_name_rule_holds_where_it_is_asked_for(tmp_path):
    prims = "\n".join(
        f'def Xform "{name}" {{\n {extra}\n def Cube "m" {{ }}\n }}'
        for name, extra in (
            ("Car_0", ""),
            ("pedestrian2", ""),
            ("Cyclist", ""),
            ("Carport", ""),
            ("Cars", ""),
            ("car_parked", 'custom string radar:target = "none"'),
            ("Car_post", "custom float radar:rcs_dbsm = 2"),
        )
    )
    asked = read(tmp_path, f'def Xform "Traffic" {{\n custom bool radar:targets_by_name = true\n {prims}\n }}')
    assert [(target.name, type(target.model).__name__) for target in asked.targets] == [
        ("/Traffic/Car_0", "Car"),
        ("/Traffic/pedestrian2", "Pedestrian"),
        ("/Traffic/Cyclist", "Cyclist"),
        ("/Traffic/Car_post", "NoneType"),
    ]
    assert [item.name for item in asked.objects] == ["/Traffic/Carport/m", "/Traffic/Cars/m", "/Traffic/car_parked/m"]
    unasked = read(tmp_path, f'def Xform "Traffic" {{\n {prims}\n }}')
    assert [target.name for target in unasked.targets] == ["/Traffic/Car_post"]
