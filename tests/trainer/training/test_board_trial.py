"""The trial of networks behind imperfect boards: every row, and a network that the boards' errors cost something."""

import pytest
from tiny_radar import small_dataset, tiny
from tiny_run import make_run

from shared.physics.errors import InputError
from trainer.training.board_trial import main, table


def test_a_table_has_each_board_and_run_and_perfect_boards_are_best(tmp_path, capsys):
    dataset, run = small_dataset(tmp_path / "data"), make_run(tmp_path / "run")
    main([str(dataset), str(run), "--frames", "4"])
    text = capsys.readouterr().out.strip()
    assert text == table(dataset, [run], 4)
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()[2:]]
    assert [row[:3] for row in rows] == [
        ["perfect", "run", ""],
        ["calibrated", "run", ""],
        ["calibrated", "run", "told"],
        ["uncalibrated", "run", ""],
        ["uncalibrated", "run", "told"],
    ]
    errors = [float(row[3]) for row in rows]
    # An untrained network is the view of plain iterations.
    assert errors[0] < errors[1] < errors[3]


def test_a_run_without_amplitudes_is_refused(tmp_path, capsys):
    dataset = small_dataset(tmp_path / "data")
    run = make_run(tmp_path / "run", model="spectral-unet", features="adaptive", target="class")
    assert tiny().target == "row"
    with pytest.raises(InputError, match=r"target = 'class'; expected a run whose images have amplitudes"):
        table(dataset, [run])
    with pytest.raises(SystemExit, match="board_trial: "):
        main([str(dataset), str(run)])
