"""What is drawn is what the record says: places of marks, lines and bars against the rows themselves."""

from __future__ import annotations

import math

import numpy as np
import pytest

from services.cli.plotting import Name
from services.errors import BadInput
from services.figures.behaviours import draw_behaviour, rotated
from services.figures.cost import draw_cost
from services.figures.curves import draw_curves
from services.figures.difficulty import draw_ladder
from services.figures.importance import draw_importance
from services.figures.parameters import coordinates, draw_parallel, draw_parameters
from services.figures.study import FIGURES, draw, write
from services.figures.style import NotApplicable, encode, signed, style, symbol
from services.figures.surrogate import draw_slice, slice_told
from services.insight import importance_json
from services.value import value_words
from tests.services.figures.conftest import CIRCLE, DIAL, PLANE, SPACE, SPHERE, metric, trial


def close(found, wanted):
    """Whether two lists of numbers, or of pairs, are the same."""
    found, wanted = np.asarray(list(found), dtype=float), np.asarray(list(wanted), dtype=float)
    return found.shape == wanted.shape and np.allclose(found, wanted)


def marks(axes, label):
    """Places of the marks that the legend calls so."""
    return sorted(
        tuple(map(float, at)) for found in axes.collections if found.get_label() == label for at in found.get_offsets()
    )


def words(figure):
    """All text in a figure."""
    from matplotlib.text import Text

    return {found.get_text() for found in figure.findobj(Text)}


class TestCost:
    def test_each_outcome_stands_at_what_had_been_spent_and_the_best_line_steps_over_answers_only(self, shown):
        trials = [
            trial(0, value=0.2, samples=100, z=1.0),
            trial(1, value=0.9, samples=50, z=0.1),
            trial(2, state="diverged", samples=300, z=1.0),
            trial(3, value=0.5, samples=100, z=1.0),
            trial(4, value=0.3, samples=100, z=1.0),
        ]
        figure = draw_cost(shown(trials))
        (axes,) = figure.axes
        assert marks(axes, "complete") == [(100, 0.2), (550, 0.5), (650, 0.3)]
        assert marks(axes, "easier version (z < 1)") == [(150, 0.9)]
        assert [x for x, _ in marks(axes, "diverged, no value")] == [450]
        (line,) = axes.lines
        assert line.get_drawstyle() == "steps-post"
        assert list(zip(*line.get_data(), strict=True)) == [(100, 0.2), (550, 0.5), (650, 0.5)]
        assert axes.get_xlabel() == "samples spent (control steps)"

    def test_the_value_has_the_name_and_unit_of_the_result_that_equals_it(self, shown):
        figure = draw_cost(shown([trial(0, value=0.4, bar=0.4), trial(1, value=0.6, bar=0.6)]))
        assert figure.axes[0].get_ylabel() == "bar (m)"
        assert value_words([trial(0, value=0.4, bar=0.4), trial(1, value=0.6, bar=0.7)]).title == "value"

    def test_without_values_there_is_no_such_figure(self, shown):
        with pytest.raises(NotApplicable, match="no trial has a value"):
            draw_cost(shown([trial(0, state="failed")]))


class TestBehaviour:
    def test_a_circle_shows_angle_and_value_and_numbers_the_strategies_best_first(self, shown):
        trials = [
            trial(0, value=0.2, features=(0.0,)),
            trial(1, value=0.8, features=(2.0,)),
            trial(2, value=0.7, features=(2.1,)),
        ]
        figure = draw_behaviour(shown(trials, CIRCLE))
        assert marks(figure.axes[0], "complete") == [(0.0, 0.2), (2.0, 0.8), (2.1, 0.7)]
        numbers = {text.get_text(): text.get_position() for text in figure.axes[0].texts if text.get_text().isdigit()}
        assert numbers == {"1": (2.0, 0.8), "2": (0.0, 0.2)}
        assert {"115°, 0.8", "0°, 0.2"} <= words(figure)

    def test_an_inclination_is_a_dial_of_half_a_turn(self, shown):
        figure = draw_behaviour(
            shown([trial(0, value=1.0, features=(0.5,)), trial(1, value=2.0, features=(3.0,))], DIAL)
        )
        axes = figure.axes[0]
        assert (axes.get_thetamin(), axes.get_thetamax()) == (0, 180)
        assert marks(axes, "complete") == [(0.5, 1.0), (3.0, 2.0)]
        assert {"face up", "face down"} <= words(figure)

    def test_a_vector_is_a_plane_with_units_and_the_declared_range(self, shown):
        rows = [trial(0, value=1.0, features=(1.0, 0.5)), trial(1, state="infeasible", features=(4.0, 1.5))]
        axes = draw_behaviour(shown(rows, PLANE)).axes[0]
        assert marks(axes, "complete") == [(1.0, 0.5)]
        assert marks(axes, "infeasible") == [(4.0, 1.5)]
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("reach (m)", "height (m)")
        assert axes.get_xlim() == pytest.approx((0.0, 5.0), abs=0.5)

    def test_a_rotation_stands_where_its_forward_axis_points(self, shown):
        half = math.sqrt(0.5)
        turned = [(0.0, 0.0, 0.0, 1.0), (0.0, half, 0.0, half), (0.0, 0.0, half, half)]
        # the x axis turned by nothing, by a quarter about y, by a quarter about z
        assert close(rotated((1, 0, 0), np.array(turned)), [(1, 0, 0), (0, 0, -1), (0, 1, 0)])
        figure = draw_behaviour(shown([trial(i, value=0.1 * i, features=q) for i, q in enumerate(turned)], SPHERE))
        axes = figure.axes[0]
        # seen from turn 0.9 and tilt 0.38: the axis over the bar at (cos 0.9, -sin 0.9 sin 0.38), "up" at (0, cos 0.38)
        at = {(round(x, 4), round(y, 4)) for x, y in marks(axes, "complete")}
        assert (round(math.cos(0.9), 4), round(-math.sin(0.9) * math.sin(0.38), 4)) in at
        assert (0.0, round(math.cos(0.38), 4)) in at
        # the third one points away from the eye, and is fainter
        behind = [found for found in axes.collections if found.get_label() == "complete" and found.get_alpha() == 0.15]
        assert [len(found.get_offsets()) for found in behind] == [1]

    @pytest.mark.parametrize(
        ("behaviour", "features", "why"), [(None, None, "plays no part"), (CIRCLE, None, "no trial has a behaviour")]
    )
    def test_what_has_no_behaviour_has_no_such_figure(self, shown, behaviour, features, why):
        with pytest.raises(NotApplicable, match=why):
            draw_behaviour(shown([trial(0, value=1.0, features=features)], behaviour))


class TestLadder:
    def test_bars_are_what_each_level_cost_and_curves_lead_from_parent_to_child(self, shown):
        trials = [
            trial(0, value=0.1, z=0.2, samples=100),
            trial(1, value=0.2, z=0.2, samples=150),
            trial(2, value=0.3, z=1.0, samples=1000, warm_start=1),
        ]
        values, costs, lineage = draw_ladder(shown(trials)).axes
        assert marks(values, "complete") == [(0.2, 0.1), (0.2, 0.2), (1.0, 0.3)]
        bars = [(bar.get_x() + bar.get_width() / 2, bar.get_height()) for bar in costs.patches]
        assert close(bars, [(0.2, 250), (1.0, 1000)])
        assert [text.get_text() for text in costs.texts] == ["2", "1"]
        (curve,) = lineage.patches
        assert curve.get_path().vertices[[0, -1]].tolist() == [[1, 0.2], [2, 1.0]]

    def test_without_difficulties_there_is_no_ladder(self, shown):
        with pytest.raises(NotApplicable, match="no trial has a difficulty"):
            draw_ladder(shown([trial(0, value=1.0)]))


class TestParameters:
    def test_each_parameter_has_a_picture_over_the_range_that_was_searched(self, shown):
        rows = [trial(i, value=0.1 * i) for i in range(6)]
        panels = draw_parameters(shown(rows)).axes[: len(SPACE)]
        assert [axes.get_xlabel() for axes in panels] == [
            "rate",
            r"$\omega_{x}$ (rad/s)",
            "layers",
            "kind",
            "turn (rad)",
        ]
        rate, omega, _, kind, _ = panels
        assert rate.get_xscale() == "log"
        assert rate.get_xlim() == pytest.approx((1e-4, 1e-1))
        assert close(marks_of(omega), sorted((row.params["omega_x"], row.value) for row in rows))
        assert {x for x, _ in marks_of(kind)} == {0.0, 1.0}
        assert [label.get_text() for label in kind.get_xticklabels()] == ["tanh", "relu"]

    def test_easier_versions_of_the_task_are_not_compared_with_it(self, shown):
        rows = [trial(0, value=9.0, z=0.1), trial(1, value=0.5, z=1.0)]
        assert marks_of(draw_parameters(shown(rows)).axes[1]) == [(rows[1].params["omega_x"], 0.5)]

    def test_parallel_lines_pass_where_their_trial_stands_and_the_best_is_on_top(self, shown):
        rows = [
            trial(0, value=0.3, features=(1.0,)),
            trial(1, value=0.1, features=(2.0,)),
            trial(2, value=0.2, features=(1.5,)),
        ]
        study = shown(rows, CIRCLE)
        names = [axis.title for axis in coordinates(study)]
        assert names == ["rate", r"$\omega_{x}$ (rad/s)", "layers", "kind", "turn (rad)", "facing (rad)", "value"]
        (lines,) = draw_parallel(study).axes[0].collections
        paths = [path.vertices for path in lines.get_paths()]
        assert close((path[-1] for path in paths), [(6, 0.0), (6, 0.5), (6, 1.0)])
        best = rows[0]
        wanted = [
            math.log10(best.params["rate"] / 1e-4) / 3,
            (best.params["omega_x"] + 3) / 6,
            (best.params["layers"] - 1) / 3,
            0.0,
            (best.params["turn"] + math.pi) / (2 * math.pi),
            0.0,
            1.0,
        ]
        assert paths[-1][:, 1] == pytest.approx(wanted)


def marks_of(axes):
    return sorted(tuple(map(float, at)) for found in axes.collections for at in found.get_offsets())


class TestCurves:
    def test_the_best_trials_are_drawn_against_their_samples(self, shown):
        told = {n: [metric(i, **{"samples": 100.0 * i, "return": n + 0.1 * i}) for i in (1, 2, 3)] for n in range(8)}
        rows = [trial(n, value=float(n)) for n in range(8)]
        axes = draw_curves(shown(rows, metrics=lambda one: told[one.number])).axes[0]
        assert [line.get_label() for line in axes.lines] == [f"trial {n} ({n})" for n in (7, 6, 5, 4, 3, 2)]
        assert close(zip(*axes.lines[0].get_data(), strict=True), [(100, 7.1), (200, 7.2), (300, 7.3)])
        assert (axes.get_xlabel(), axes.get_ylabel()) == ("samples (control steps)", "return")

    def test_without_samples_iterations_are_counted(self, shown):
        rows = [trial(0, value=1.0)]
        axes = draw_curves(
            shown(rows, metrics=lambda _: [metric(1, kl=0.5, success=0.1), metric(2, kl=0.4, success=0.3)])
        ).axes[0]
        assert axes.lines[0].get_xdata().tolist() == [1, 2]
        assert axes.lines[0].get_ydata().tolist() == [0.1, 0.3]
        assert axes.get_xlabel() == "iteration"

    @pytest.mark.parametrize(
        ("told", "why"), [([], "no trial has a learning curve"), ([metric(1, value=1.0)], "more than one iteration")]
    )
    def test_a_single_point_is_no_curve(self, shown, told, why):
        with pytest.raises(NotApplicable, match=why):
            draw_curves(shown([trial(0, value=1.0)], metrics=lambda _: told))


@pytest.fixture(scope="module")
def learnt():
    """Trials whose value follows one parameter."""
    return [trial(i, value=math.sin(trial(i).params["omega_x"])) for i in range(14)]


class TestSurrogate:
    def test_bars_are_the_importances_that_the_page_shows(self, shown, learnt):
        study = shown(learnt, strategy="gp_ucb")
        told = {one["name"]: one for one in importance_json(study.looked)["parameters"]}
        (axes,) = draw_importance(study).axes
        names = [label.get_text() for label in axes.get_yticklabels()]
        assert names[-1] == r"$\omega_{x}$"
        ascending = sorted(told.values(), key=lambda one: one["permutation"])
        assert [bar.get_width() for bar in axes.patches] == pytest.approx([one["permutation"] for one in ascending])
        assert [x for x, _ in axes.collections[-1].get_offsets()] == pytest.approx(
            [one["from_length_scales"] for one in ascending]
        )

    def test_a_slice_shows_the_surrogates_mean_and_deviation_with_samples(self, shown, learnt):
        space = {name: SPACE[name] for name in ("omega_x", "rate")}
        rows = [trial(i, value=row.value) for i, row in enumerate(learnt)]
        for row in rows:
            for name in ("layers", "kind", "turn"):
                del row.params[name]
        study = shown(rows, strategy="gp_ucb", space=space)
        told = slice_told(study)
        figure = draw_slice(study)
        mean, deviation = figure.axes[:2]
        assert mean.collections[0].get_array().ravel().tolist() == pytest.approx(np.ravel(told["mean"]).tolist())
        assert deviation.collections[0].get_array().ravel().tolist() == pytest.approx(
            np.ravel(told["deviation"]).tolist()
        )
        assert {told["x"]["name"], told["y"]["name"]} == {"omega_x", "rate"}
        drawn = sorted(tuple(at) for at in mean.collections[1].get_offsets().tolist())
        x, y = told["x"]["name"], told["y"]["name"]
        assert close(drawn, sorted((row.params[x], row.params[y]) for row in rows))

    def test_over_one_parameter_it_is_a_line_with_its_band(self, shown, learnt):
        rows = [trial(i, value=row.value) for i, row in enumerate(learnt)]
        for row in rows:
            for name in ("layers", "kind", "turn", "rate"):
                del row.params[name]
        study = shown(rows, strategy="gp_ucb", space={"omega_x": SPACE["omega_x"]})
        axes = draw_slice(study).axes[0]
        told = slice_told(study)
        assert axes.lines[0].get_ydata() == pytest.approx(told["mean"][0])
        assert close(marks(axes, "complete"), sorted((row.params["omega_x"], row.value) for row in rows))


class TestWholeStudies:
    def test_what_does_not_apply_is_left_out_and_said(self, shown):
        drawn = draw(shown([trial(i, value=0.1 * i) for i in range(3)]))
        assert set(drawn.figures) | set(drawn.left_out) == set(FIGURES) == {name.value for name in Name}
        assert drawn.left_out["ladder"] == "no trial has a difficulty"
        assert drawn.left_out["behaviour"] == "behaviour plays no part in this study"
        assert drawn.left_out["curves"] == "no trial has a learning curve"
        assert {"cost", "parallel", "parameters"} <= set(drawn.figures)

    def test_the_same_study_gives_the_same_bytes_in_the_asked_form(self, shown):
        study = shown([trial(0, value=0.4), trial(1, value=0.6)])
        for form, magic in (("svg", b"<?xml"), ("pdf", b"%PDF"), ("png", b"\x89PNG")):
            with style():
                first, second = (encode(draw_cost(study), form) for _ in range(2))
            assert first == second
            assert first.startswith(magic)

    def test_many_marks_make_no_large_file(self, shown):
        with style():
            figure = draw_cost(shown([trial(i, value=0.001 * (i % 997)) for i in range(3000)]))
        assert len(encode(figure, "svg")) < 200_000

    def test_a_paper_takes_the_fonts_and_the_width(self, shown):
        with style():
            figure = draw_cost(shown([trial(0, value=0.4)]))
        assert figure.get_figwidth() == 3.4
        assert b"/Type3" not in encode(figure, "pdf")

    def test_nothing_is_left_where_nothing_can_be_written(self, shown, tmp_path):
        drawn = draw(shown([trial(0, value=0.4)]), ["cost", "parameters"])
        (tmp_path / "parameters.svg").mkdir()
        with pytest.raises(
            BadInput, match=r"--out: expected a folder that can be written, found the folder .* in the way"
        ):
            write(drawn, tmp_path, "svg")
        assert [path.name for path in tmp_path.iterdir()] == ["parameters.svg"]
        (tmp_path / "file").touch()
        with pytest.raises(
            BadInput, match=r"--out: expected a folder that can be written, found .*/file/sub: Not a dir"
        ):
            write(drawn, tmp_path / "file" / "sub", "svg")

    def test_a_study_without_finished_trials_is_told(self, shown):
        with pytest.raises(BadInput, match="expected finished trials to draw, found none"):
            shown([trial(0, state="running")])


def test_names_become_symbols_and_no_text_becomes_mathematics():
    assert symbol("omega_x") == r"$\omega_{x}$"
    assert symbol("v_z") == "$v_{z}$"
    assert symbol("alpha") == r"$\alpha$"
    assert symbol("ppo.critic_rate") == "ppo.critic rate"
    assert symbol("cost_$") == r"cost \$"
    assert signed("trial 3 (-2.5), x-1, 1e-05") == "trial 3 (−2.5), x-1, 1e-05"
