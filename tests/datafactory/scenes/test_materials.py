"""Materials: the published formulas behind the table, names that scenes use, and files that users write."""

import importlib.util
import json
import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from datafactory.scenes.materials.reflectivity import (
    VACUUM_PERMITTIVITY,
    fresnel_reflectivity,
    lambertian_sigma0,
    scattering_coefficient_for_sigma0,
)
from datafactory.scenes.materials.table import FREQUENCY_HZ, load_materials

GHZ = FREQUENCY_HZ / 1e9
SIGMA_PER_LOSS = 2.0 * math.pi * FREQUENCY_HZ * VACUUM_PERMITTIVITY
TABLE = load_materials()


def itu_p2040(f_ghz: float, a: float, b: float, c: float, d: float) -> tuple[float, float]:
    """eps' = a f^b and sigma = c f^d, f in GHz (ITU-R P.2040-4, section 2.1.4)."""
    return a * f_ghz**b, c * f_ghz**d


def p527_water(f_ghz: float, celsius: float) -> complex:
    """Pure water, ITU-R P.527-6 section 5.1.1: two Debye terms; eps' - j eps''."""
    theta = 300.0 / (celsius + 273.15) - 1.0
    f1 = 20.20 - 146.4 * theta + 316.0 * theta**2
    f2 = 39.8 * f1
    static = 77.66 + 103.3 * theta
    middle = 0.0671 * static
    infinite = 3.52 - 7.52 * theta
    first, second = (static - middle) / (1 + 1j * f_ghz / f1), (middle - infinite) / (1 + 1j * f_ghz / f2)
    return infinite + first + second


def p527_soil(f_ghz: float, water: float, celsius: float = 20.0) -> complex:
    """Silty loam of 22.5 % sand, 15 % clay, 62.5 % silt and a volumetric water content, ITU-R P.527-6 section 5.2."""
    sand, clay, silt, density = 22.5, 15.0, 62.5, 2.65
    bulk = 1.07256 + 0.078886 * math.log(sand) + 0.038753 * math.log(clay) + 0.032732 * math.log(silt)
    sigma1 = 0.0467 + 0.2204 * bulk - 0.004111 * sand - 0.006614 * clay
    sigma2 = -1.645 + 1.939 * bulk - 0.0225622 * sand + 0.01594 * clay
    relaxed = (sigma1 - sigma2) / (1 + (f_ghz / 1.35) ** 2)
    weight = (density - bulk) / (density * water) * 18.0 / f_ghz
    free = p527_water(f_ghz, celsius)
    real = free.real + relaxed * f_ghz / 1.35 * weight
    loss = -free.imag + (relaxed + sigma2) * weight
    dry = (1.01 + 0.44 * density) ** 2 - 0.062
    power = 0.65
    eps = (
        1
        + bulk / density * (dry**power - 1)
        + water ** (1.2748 - 0.00519 * sand - 0.00152 * clay) * real**power
        - water
    ) ** (1 / power)
    return complex(eps, -((water ** (1.33797 - 0.00603 * sand - 0.00166 * clay) * loss**power) ** (1 / power)))


ITU_ROWS = {
    "concrete": (5.24, 0.0, 0.0462, 0.7822),
    "plasterboard": (2.73, 0.0, 0.0085, 0.9395),
    "wood": (1.99, 0.0, 0.0047, 1.0718),
    "glass": (6.31, 0.0, 0.0036, 1.3394),
    "ceiling_board": (1.48, 0.0, 0.0011, 1.0750),
    "chipboard": (2.58, 0.0, 0.0217, 0.7800),
    "floorboard": (3.66, 0.0, 0.0044, 1.3515),
    "metal": (1.0, 0.0, 1e7, 0.0),
}


@pytest.mark.parametrize("name", ITU_ROWS)
def test_rows_within_itu_range_follow_its_power_laws(name):
    material = TABLE.materials[name]
    permittivity, conductivity = itu_p2040(GHZ, *ITU_ROWS[name])
    assert material.valid_ghz[0] <= GHZ <= material.valid_ghz[1]
    assert material.relative_permittivity == pytest.approx(permittivity, rel=5e-3)
    assert material.conductivity_s_per_m == pytest.approx(conductivity, rel=5e-3)


@pytest.mark.parametrize(
    ("name", "lower", "lower_ghz", "upper"),
    [
        ("brick", (3.91, 0.0, 0.0238, 0.16), 40.0, (4.15, 0.0, 0.0006, 1.5712)),
        ("marble", (7.074, 0.0, 0.0055, 0.9262), 60.0, (7.94, 0.0, 0.0001, 1.7330)),
        ("plywood", (2.71, 0.0, 0.33, 0.0), 40.0, (1.94, 0.0, 0.0067, 0.9982)),
    ],
)
def test_rows_between_itu_ranges_are_interpolated_and_say_so(name, lower, lower_ghz, upper):
    """From one row's end to 110 GHz, where the next begins: eps' straight over log f, sigma over log f in log sigma."""
    weight = math.log(GHZ / lower_ghz) / math.log(110.0 / lower_ghz)
    below, above = itu_p2040(lower_ghz, *lower), itu_p2040(110.0, *upper)
    permittivity = (1 - weight) * below[0] + weight * above[0]
    conductivity = below[1] ** (1 - weight) * above[1] ** weight
    material = TABLE.materials[name]
    assert material.relative_permittivity == pytest.approx(permittivity, rel=2e-3)
    assert material.conductivity_s_per_m == pytest.approx(conductivity, rel=0.02)
    assert any("between two rows" in text for text in material.assumptions)


@pytest.mark.parametrize(
    ("name", "water"), [("very_dry_ground", 0.07), ("medium_dry_ground", 0.2), ("wet_ground", 0.5)]
)
def test_ground_follows_p527(name, water):
    expected = p527_soil(GHZ, water)
    assert TABLE.materials[name].relative_permittivity == pytest.approx(expected.real, rel=2e-3)
    assert TABLE.materials[name].conductivity_s_per_m == pytest.approx(-expected.imag * SIGMA_PER_LOSS, rel=2e-3)


def test_water_follows_p527():
    expected = p527_water(GHZ, 20.0)
    assert TABLE.materials["water"].relative_permittivity == pytest.approx(expected.real, rel=2e-3)
    assert TABLE.materials["water"].conductivity_s_per_m == pytest.approx(-expected.imag * SIGMA_PER_LOSS, rel=2e-3)


def test_bumper_follows_its_loss_tangent():
    bumper = TABLE.materials["polypropylene"]
    expected = SIGMA_PER_LOSS * bumper.relative_permittivity * 0.0034
    assert bumper.conductivity_s_per_m == pytest.approx(expected, rel=2e-3)


def test_every_material_names_its_source_and_what_is_assumed():
    for material in TABLE.materials.values():
        assert material.source
        assert any("S is an assumption" in text or text.startswith("S =") for text in material.assumptions), (
            material.name
        )


@given(st.floats(-60.0, -35.0), st.floats(3.0, 90.0))
def test_scattering_coefficient_gives_back_its_sigma0(sigma0_db, grazing_deg):
    coefficient = scattering_coefficient_for_sigma0(sigma0_db, grazing_deg, 5.0, 30.0, FREQUENCY_HZ)
    incidence = math.radians(90.0 - grazing_deg)
    reflectivity = fresnel_reflectivity(5.0, 30.0, FREQUENCY_HZ, incidence, "tm")
    assert coefficient < 1.0
    assert 10 * math.log10(float(lambertian_sigma0(coefficient, reflectivity, incidence))) == pytest.approx(sigma0_db)


def test_scattering_coefficient_is_capped():
    assert scattering_coefficient_for_sigma0(20.0, 5.0, 7.0, 1.0, FREQUENCY_HZ) == 1.0


def test_lambertian_sigma0_conserves_power():
    """The bistatic 4 S^2 Gamma^2 cos_i cos_s, integrated over the half-space, is 4 pi S^2 Gamma^2 cos_i."""
    incidence, reflectivity, coefficient = 0.3, 0.2, 0.4
    scattered = np.linspace(0.0, math.pi / 2, 2001)
    monostatic = float(lambertian_sigma0(coefficient, reflectivity, incidence))
    bistatic = monostatic / math.cos(incidence) * np.cos(scattered)
    total = np.trapezoid(bistatic * 2 * math.pi * np.sin(scattered), scattered)
    assert total / (4 * math.pi) == pytest.approx(coefficient**2 * reflectivity * math.cos(incidence), rel=1e-6)


def excess_of_road_db(name: str, grazing_deg: float) -> float:
    """sigma0 over -20 dB x sin(grazing), for vertical polarisation."""
    road, incidence = TABLE.materials[name], math.radians(90.0 - grazing_deg)
    reflectivity = fresnel_reflectivity(
        road.relative_permittivity, road.conductivity_s_per_m, FREQUENCY_HZ, incidence, "tm"
    )
    sigma0 = float(lambertian_sigma0(road.scattering_coefficient, reflectivity, incidence))
    return 10 * math.log10(sigma0 / math.cos(incidence)) + 20.0


@pytest.mark.parametrize("name", ["asphalt", "road_concrete"])
def test_roads_have_the_stated_backscatter(name):
    assert excess_of_road_db(name, 5.0) == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize(("grazing_deg", "excess_db"), [(10, -2.0), (15, -7.2), (20, -24.7), (30, -3.5)])
def test_asphalt_has_a_null_that_no_road_has(grazing_deg: float, excess_db: float) -> None:
    """What docs/effects.md says of ground seen from above."""
    assert excess_of_road_db("asphalt", grazing_deg) == pytest.approx(excess_db, abs=0.1)


SUBSTANCES = {
    "mat-itu_concrete": "concrete", "itu-brick.001": "brick", "/World/Looks/M_Asphalt_01": "asphalt", "Glas_2": "glass",
    "windows": "glass", "Road": "asphalt", "tarmac": "asphalt", "concreteRoad": "road_concrete", "STRAßE": "asphalt",
    "Stainless Steel": "metal", "aluminium": "metal", "tree.013": "vegetation", "front_left_tyre": "tyre_rubber",
    "facade": "concrete", "brick_facade": "brick", "glass_roof": "glass", "mat-terrain": "medium_dry_ground",
    "itu_very_dry_ground": "very_dry_ground", "ceiling_board": "ceiling_board",
}  # fmt: skip


@pytest.mark.parametrize(("name", "expected"), SUBSTANCES.items())
def test_names_lead_to_substances(name, expected):
    material, rule = TABLE.lookup(name)
    assert material.name == expected
    assert rule != "default"


def test_unknown_names_get_the_default_and_are_listed():
    mapping = TABLE.map_materials(["white", "brick", "", "white"])
    assert mapping.unknown == ("white", "")
    assert mapping["white"].name == "concrete"
    assert mapping.to_json()["names"] == {
        "white": {"material": "concrete", "rule": "default"},
        "brick": {"material": "brick", "rule": "name"},
        "": {"material": "concrete", "rule": "default"},
    }
    stored = json.loads(json.dumps(mapping.to_json()))
    assert stored["names"]["brick"] == {"material": "brick", "rule": "name"}
    assert stored["materials"]["brick"]["relative_permittivity"] == 4.06
    assert stored["unknown"] == ["white", ""]


def test_every_material_is_found_by_its_own_name():
    for name in TABLE.materials:
        assert TABLE.lookup(name)[0].name == name
        assert TABLE.lookup(f"mat-itu_{name}.001")[0].name == name


@pytest.mark.parametrize("city", ["munich", "etoile", "florence", "san_francisco", "simple_street_canyon_with_cars"])
def test_the_built_in_cities_have_no_unknown_material(city):
    """The names of the scene files themselves, read without importing Sionna."""
    package = importlib.util.find_spec("sionna")
    assert package is not None
    assert package.submodule_search_locations
    file = Path(package.submodule_search_locations[0], "rt", "scenes", city, f"{city}.xml")
    names = [material.attrib["id"] for material in ElementTree.parse(file).iter("bsdf")]
    mapping = TABLE.map_materials(names)
    assert len(mapping.entries) >= 3
    assert mapping.unknown == ()


def written(tmp_path, text):
    path = tmp_path / "materials.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_file_overrides_extends_and_maps(tmp_path):
    table = load_materials(
        written(
            tmp_path,
            """
            default = "brick"
            [material.brick]
            scattering_coefficient = 0.25
            [material.asphalt]
            scattering_coefficient = 0.5
            [material.foam]
            relative_permittivity = 1.1
            conductivity = 0.001
            aliases = ["styrofoam", "wall"]
            [map]
            "Blender.Wall" = "glass"
            """,
        )
    )
    assert table.materials["brick"].scattering_coefficient == 0.25
    assert table.materials["brick"].relative_permittivity == 4.06
    assert "materials.toml" in table.materials["brick"].source
    assert table.materials["asphalt"].scattering_coefficient == 0.5
    assert table.lookup("Styrofoam_02")[0].name == "foam"
    assert table.lookup("wall")[0].name == "foam"
    assert table.lookup("Blender.Wall") == (table.materials["glass"], "map")
    assert table.lookup("nothing known")[0].name == "brick"
    assert table.lookup("Blender.Wall", "metal") == (table.materials["glass"], "map")
    assert table.lookup("wall", "metal") == (table.materials["metal"], "stated 'metal'")
    assert table.lookup("metal", "vinyl_tile") == (table.materials["brick"], "default, stated 'vinyl_tile'")
    assert table.map_materials(["metal"], {"metal": "vinyl_tile"}).unknown == ("metal",)
    assert "S = 0.3 is an assumption" in table.materials["foam"].assumptions


def test_file_can_state_a_backscatter_instead_of_a_coefficient(tmp_path):
    table = load_materials(written(tmp_path, "[material.concrete]\nsigma0_db = -25.0\ngrazing_deg = 10.0"))
    expected = scattering_coefficient_for_sigma0(-25.0, 10.0, 5.24, 1.381, FREQUENCY_HZ)
    assert table.materials["concrete"].scattering_coefficient == pytest.approx(expected)
