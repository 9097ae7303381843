"""Evidence with discrepancies, and the posterior, on linear problems whose answer is known.

What carries the weight: the fast evidence is the normal density of the whole covariance, written out; recordings drawn
from a hypothesis with a discrepancy are judged with probabilities that come true.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pytest
from fretflow.inference.decision import decide
from fretflow.inference.evidence import (
    FORMS,
    SIZES,
    Discrepancy,
    code_size,
    harmonics,
    modulations,
    rates,
    size_prior,
    smooth_functions,
    waves,
)
from fretflow.inference.experiment import Measurement, Point
from fretflow.inference.law_forms import density, law_form_errors
from fretflow.inference.least_squares import Fitter
from fretflow.inference.parameters import Array, Coordinate, Parameters
from fretflow.inference.posterior import left_out, mostly_by_form
from fretflow.inference.search import FAST, Search, Start
from fretflow.inference.verdict import Verdict
from scipy.linalg import block_diag
from scipy.stats import multivariate_normal
from waves import BASELINE, LOOPS, SAMPLES, SD, SHAPES, Waves, cosine, judged, measurement, wave


def test_evidence_is_the_density_of_the_whole_covariance() -> None:
    """With both discrepancies, at every size, up to the constant that all hypotheses share."""
    experiment = Waves(measurement(cosine() + 0.25 * wave("viscous")))
    own, known = experiment.measurement, experiment.measurement.covariance()
    fit = Fitter(experiment, known).at(Point(experiment.parameters(["viscous"]), np.array([0.1, -0.2])), None)
    signature = 0.3 * wave("viscous")
    table = Discrepancy(own, known).evidence(fit, modulations(own, signature)).table
    sigma = np.diag(known.variance) + known.modes @ known.modes.T + fit.jacobian @ fit.jacobian.T
    start = own.values - fit.predicted + fit.jacobian @ fit.z
    (common, single), modulated = smooth_functions(own), modulations(own, signature)
    written = np.array([[[multivariate_normal.logpdf(start, cov=(
        sigma + size**2 * common @ common.T + tau**2 * single @ single.T + form**2 * modulated @ modulated.T))
        for tau in SIZES[::5]] for size in SIZES[::5]] for form in FORMS[::6]])
    assert table[::6, ::5, ::5] - table[0, 0, 0] == pytest.approx(written - written[0, 0, 0], abs=1e-5)


def test_codes_that_do_not_differ_have_a_prior() -> None:
    """The smallest size takes most of it, and all of it is there; it was nought over nought."""
    prior = size_prior(0.0)
    assert prior.sum() == pytest.approx(1.0)
    assert int(np.argmax(prior)) == 0


@pytest.mark.parametrize("where", ["one loop", "all loops"])
def test_law_form_errors_have_the_size_that_they_are(where: str) -> None:
    """An error of 0.2 of all that an effect does, as rms, is told as that, be it spread or in a single loop."""
    own = measurement()
    change = 0.3 * wave("viscous")
    shape = np.where(own.group == LOOPS // 2, np.sqrt(LOOPS), 0.0) if where == "one loop" else np.sqrt(2.0) * np.cos(
        4.0 * np.pi * own.phase)
    noise = SD * np.random.default_rng(2).standard_normal(len(own.values))
    experiment = Waves(measurement(cosine() + change * (1.0 + 0.2 * shape) + 0.1 * noise, 0.1 * SD))
    known, space = experiment.measurement.covariance(), experiment.parameters(["viscous"])
    fit = Fitter(experiment, known).fit(Point(space, np.zeros(space.size)), None)
    evidence = Discrepancy(experiment.measurement, known).evidence(fit, modulations(experiment.measurement, change))
    assert 0.08 < float(FORMS[int(np.argmax(evidence.table[:, 0, 0]))]) < 0.45  # nothing else being wrong


def test_an_input_is_off_by_nothing_but_its_time() -> None:
    """No code and no law gets the drive wrong; it may come early, in all loops alike or in each."""
    own = replace(measurement(), channels=("force", "drive"), channel=np.arange(len(measurement().values)) % 2,
                  inputs=frozenset({"drive"}))
    drive = own.channel == 1
    for functions in smooth_functions(own):
        moved = functions[:, np.any(functions[drive], axis=0)]
        assert moved.any()
        slopes = np.column_stack([np.where(own.group == one, rates(own), 0.0) for one in range(len(own.groups))])
        assert np.linalg.matrix_rank(np.hstack([slopes, moved])[drive]) == len(own.groups)


def test_smooth_functions_have_the_size_that_they_are_asked_for() -> None:
    """At size one the mean variance is that of the channel, one here, once in height and once in time.

    Modulations keep a signature's; where a loop shows little of it they are as large as in the others.
    """
    own = measurement()
    for functions in smooth_functions(own):
        assert np.mean(np.sum(functions**2, axis=1)) == pytest.approx(2.0, rel=0.15)
    assert np.sum(harmonics(own.phase, 5)**2, axis=1) == pytest.approx(np.ones(len(own.values)))
    change = wave("viscous")
    assert np.sum(modulations(own, change)**2) == pytest.approx(np.sum(change**2), rel=0.15)
    fading = change * np.where(own.group < LOOPS // 2, 1.0, 0.1)
    made = np.sqrt(np.sum(modulations(own, fading)**2, axis=1))
    late, early = (float(np.sqrt(np.mean(made[rows]**2))) for rows in (own.group == LOOPS - 1, own.group == 0))
    assert 0.5 < late / early < 1.5
    # what a law does to a map says nothing of how far it may be off in loops
    mapped = replace(own, channels=("force", "map"), channel=np.where(own.group == LOOPS - 1, 1, 0))
    shown = np.where(own.group == LOOPS - 1, 20.0, 1.0) * change
    made = np.sqrt(np.sum(modulations(mapped, shown)**2, axis=1))
    loops, depths = (float(np.sqrt(np.mean(made[rows]**2))) for rows in (own.group == 0, own.group == LOOPS - 1))
    assert 10.0 < depths / loops < 40.0


def mapped() -> Measurement:
    """Return the six loops with a map of 15 x 15 points, of size one, of which codes differ by a twentieth."""
    own, line = measurement(), np.linspace(0.0, 1.0, 15)
    place = np.array(np.meshgrid(line, line)).reshape(2, -1).T
    size = len(place)
    more = {"values": np.ones(size), "variance": np.full(size, SD**2), "repeatable": np.ones(size),
            "channel": np.ones(size, dtype=int), "phase": np.full(size, np.nan), "group": np.full(size, LOOPS - 1),
            "cycles": np.full(size, np.nan), "condition": np.zeros(size, dtype=int)}
    return replace(own, channels=("force", "depth"), modes=np.zeros((len(own.values) + size, 0)),
                   code_error=block_diag(own.code_error, 0.05 * np.ones((size, 1))),
                   place=np.vstack([np.full((len(own.values), 2), np.nan), place]),
                   **{name: np.append(getattr(own, name), values) for name, values in more.items()})


def test_a_face_is_off_smoothly_by_what_codes_differ_by_there() -> None:
    """Over the face, with the rms that codes differ by; such a ridge at its edge is, and no single points are."""
    own = mapped()
    depth = own.channel == 1
    common = smooth_functions(own)[0]
    rms = np.sqrt(np.mean(np.sum(common[depth]**2, axis=1)))
    assert rms * code_size(own) == pytest.approx(0.05, rel=0.05)
    assert np.sqrt(np.mean(np.sum(waves(own, 7)[depth]**2, axis=1))) == pytest.approx(1.0, rel=0.05)
    ridge = np.where(own.place[depth][:, 1] < 0.1, 1.0, 0.0)
    chessboard = np.where(np.arange(depth.sum()) % 2, 1.0, -1.0)
    basis, _ = np.linalg.qr(common[depth][:, np.any(common[depth], axis=0)])
    held = [float(np.linalg.norm(basis.T @ one) / np.linalg.norm(one)) for one in (ridge, chessboard)]
    assert held[0] > 0.9
    assert held[1] < 0.3


def test_errors_in_a_model_move_single_loops_along_what_they_change() -> None:
    """All channels at once, each condition by itself: a size of one is a relative error of one at each."""
    plain = replace(measurement(), condition=np.where(measurement().group == LOOPS - 1, 1, 0))
    change = np.exp(np.linspace(0.0, 1.0, len(plain.values)))
    moving = smooth_functions(replace(plain, embedded=change[:, None]))
    assert moving[0] == pytest.approx(smooth_functions(plain)[0])
    added = moving[1] @ moving[1].T - smooth_functions(plain)[1] @ smooth_functions(plain)[1].T
    last = plain.condition == 1
    share = added / np.outer(change, change)
    assert np.ptp(share[np.ix_(last, last)]) == pytest.approx(0.0, abs=1e-9)  # one error there
    assert np.mean(np.diag(share)) == pytest.approx(1.0)
    assert share[np.ix_(plain.group == 0, plain.group == 0)] == pytest.approx(0.0, abs=1e-9)  # where the walk begins


def test_rates_are_derivatives_by_the_loops_angle() -> None:
    """Of a cosine the derivative is its sine, wherever in the period the samples are; without a phase there is none."""
    own = measurement()
    assert rates(own) == pytest.approx(-np.sqrt(2.0) * np.sin(2.0 * np.pi * own.phase), abs=1e-9)
    assert not rates(replace(own, phase=np.full(len(own.values), np.nan))).any()


def test_code_error_sets_the_size_of_what_codes_differ_by() -> None:
    """Modes of a hundredth of the channel's size: half of that is its rms; nine tenths of the prior lie below twice."""
    own = measurement()
    assert code_size(own) == pytest.approx(0.01 * np.sqrt(0.5), rel=1e-6)
    prior = size_prior(0.01)[0]
    assert prior[SIZES < 0.022].sum() > 0.85
    assert prior[SIZES > 0.04].sum() < 1e-3
    formed = size_prior(0.01, np.array([0.0, 0.1]))
    assert formed[0] == pytest.approx(prior)
    assert formed[1, SIZES > 0.04].sum() > 0.5  # laws of another form make larger differences


def test_a_channel_of_noise_alone_sets_no_size() -> None:
    """Codes differ there by a third of what is no size; beside a channel that moves by fifty noises that is nothing."""
    own, generator = measurement(), np.random.default_rng(2)
    silent = SD * generator.standard_normal(len(own.values))
    both = replace(
        own, values=np.append(own.values, silent), variance=np.tile(own.variance, 2),
        modes=np.zeros((2 * len(own.values), 0)), repeatable=np.ones(2 * len(own.values)),
        code_error=np.vstack([own.code_error, 0.3 * SD * np.sqrt(2.0) * np.sin(2.0 * np.pi * own.phase)[:, None]]),
        channel=np.repeat([0, 1], len(own.values)), channels=("force", "approach"),
        **{name: np.tile(getattr(own, name), 2) for name in ("phase", "group", "cycles", "condition")})
    assert code_size(both) == pytest.approx(code_size(own), rel=0.4)


def test_forms_of_one_law_differ_by_a_tenth_and_not_by_all() -> None:
    """Refitted published forms leave some hundredths of a law in the middle, and hardly ever half of it."""
    errors = law_form_errors()
    assert 0.003 < float(np.median(errors)) < 0.1
    assert float(np.mean(errors > 0.5)) < 0.02
    share = density(errors, FORMS)
    assert share.sum() == pytest.approx(1.0)
    assert share[FORMS > 1.0].sum() < 0.01


def start_of(name: str, change: np.ndarray) -> Start:
    """Return an effect that was begun and changes a whitened recording so."""
    return Start(name, change[:, None], change[:, None])


def test_what_is_left_out_is_not_explained_by_what_is_orthogonal_to_it() -> None:
    """Of three effects two are near aliases: these explain each other to their sine, the third to nothing."""
    axes = 50.0 * np.eye(3)
    alias = 0.995 * axes[0] + np.sqrt(1.0 - 0.995**2) * axes[1]
    starts = [start_of(name, one) for name, one in zip(SHAPES, (axes[0], alias, axes[2]), strict=False)]
    shares = left_out(starts, 1, len(starts))
    assert shares[FORMS < 0.3].sum() == pytest.approx(2.0 / 3.0, abs=0.1)  # a tenth of their size is left, the sine
    assert shares[FORMS > 0.3].sum() == pytest.approx(1.0 / 3.0, abs=0.1)


def test_two_others_explain_what_one_cannot() -> None:
    """A sum of two orthogonal effects is as far off either as these are large, and of both together nothing is left."""
    axes = 50.0 * np.eye(4)
    names = list(SHAPES)
    starts = [start_of(names[0], axes[0] + axes[1]), start_of(names[1], axes[0]), start_of(names[2], axes[1])]
    one, two = (left_out(starts, size, len(starts)) for size in (1, 2))
    assert one[FORMS > 0.3].sum() > 0.9
    assert two[FORMS < 0.1].sum() > 0.2  # one of the three


@pytest.mark.parametrize("listed", [1, 2])
def test_small_catalogues_have_no_second_other(listed: int) -> None:
    """Of two effects the other one is all that explains; where there is one alone, all errors are alike."""
    starts = [start_of(name, 50.0 * one) for name, one in zip(list(SHAPES)[:listed], np.eye(3), strict=False)]
    one, two = (left_out(starts, size, listed) for size in (1, 2))
    np.testing.assert_allclose(one, two)
    assert one.sum() == pytest.approx(1.0)


def test_effects_that_nobody_would_see_tell_nothing_of_those_that_are_missed() -> None:
    """Two aliases far below the noise, as changes of a wear law where little wears, do not count."""
    axes = np.eye(3)
    seen = [start_of(name, one) for name, one in zip(SHAPES, (50.0 * axes[0], 50.0 * axes[2]), strict=False)]
    names = list(SHAPES)[2:4]
    hidden = [start_of(name, 0.1 * axes[1]) for name in names]
    np.testing.assert_allclose(left_out([*seen, *hidden], 1, 4), left_out(seen, 1, 4))


def test_one_wave_is_named_with_its_size_and_two_as_two() -> None:
    """Noise and another form of a law by a twentieth stand no name in the way."""
    generator = np.random.default_rng(3)
    own = measurement()
    shifted = wave("viscous") * (1.0 + 0.05 * np.cos(2.0 * np.pi * own.phase))
    noise = SD * generator.standard_normal(len(own.values))
    search = judged(1.1 * cosine() + 0.35 * shifted + noise)
    verdict = decide(search)
    assert (verdict.verdict, verdict.effects) == (Verdict.NAMED, ("viscous",))
    mean, covariance = search.evidence(verdict.after).coordinates(search.prior(verdict.after))
    sd = np.sqrt(np.diag(covariance))
    size = search.fits[verdict.after].parameters.coordinates[-1]
    assert size.value(mean[-1] - 2.0 * sd[-1]) < 0.35 < size.value(mean[-1] + 2.0 * sd[-1])
    both = judged(cosine() + 0.35 * wave("viscous") + 0.3 * wave("support-nonlinearity") + noise)
    assert decide(both).effects == ("support-nonlinearity", "viscous")


class KnownSizes(Waves):
    """Waves whose sizes are known to a hundredth."""

    def parameters(self, effects: Sequence[str], signs: Mapping[str, float] | None = None) -> Parameters:
        """Return the size of the cosine, and those of the effects."""
        own = tuple(Coordinate(name, "size", 0.3, 0.003, False, 0.0) for name in sorted(effects))
        return Parameters(tuple(sorted(effects)), (*BASELINE, *own))


@pytest.mark.parametrize(("kept", "swing", "by_form"), [(0.3, 1.0, True), (1.0, 1.0, True), (1.0, 0.5, False)])
def test_a_law_that_is_not_there_is_not_seen_by_other_forms_of_it(kept: float, swing: float, by_form: bool) -> None:
    """A wave of the catalogue, a third of it, or all, modulated by as much as it is or by half of that."""
    own, name = measurement(), "sensor-inertia"
    shape = kept + swing * np.sqrt(2.0) * np.cos(2.0 * np.pi * own.phase)
    experiment = KnownSizes(measurement(cosine() + 0.3 * shape * wave(name)), (name,))
    search = Search(experiment, lambda function, arguments: [function(one) for one in arguments], FAST)
    for effects in ((), (name,)):
        parameters = experiment.parameters(effects)
        point = Point(parameters, np.zeros(len(parameters.coordinates)))
        search.keep([search.fitter.fit(point, experiment.predict(point), 5)])
    names = frozenset({name})
    assert search.log_evidence(names) > search.log_evidence(frozenset()) + 10.0  # with forms it explains much
    assert mostly_by_form(search, names, name) is by_form


def test_noise_and_what_codes_differ_by_are_nothing() -> None:
    """A smooth difference of half the code error's size has no name."""
    generator = np.random.default_rng(8)
    own = measurement()
    smooth = np.hstack(smooth_functions(own)) / 2.0
    error = 0.5 * code_size(own) * smooth @ generator.standard_normal(smooth.shape[1])
    verdict = decide(judged(cosine() + error + SD * generator.standard_normal(len(own.values))))
    assert verdict.verdict is Verdict.NONE
    assert verdict.probability > 0.5


def test_an_effect_that_is_not_listed_is_unknown() -> None:
    """The wave is taken out of the catalogue; what is like none of the others stays without a name."""
    generator = np.random.default_rng(5)
    rest = tuple(name for name in SHAPES if name != "sensor-inertia")
    noise = SD * generator.standard_normal(LOOPS * SAMPLES)
    verdict = decide(judged(cosine() + 0.3 * wave("sensor-inertia") + noise, rest))
    assert (verdict.verdict, verdict.effects) == (Verdict.UNKNOWN, ())


def test_probabilities_come_true() -> None:
    """Recordings drawn from the prior, unlisted effects among them: of what has a probability, so much is right."""
    generator = np.random.default_rng(11)
    names, told, right, sd = list(SHAPES), [], [], 0.5  # effects of their prior's size come to 5 times this noise
    for _ in range(60):
        hidden = generator.choice([*names, "", "unlisted"])
        values = cosine() * np.exp(0.3 * generator.standard_normal())
        own = abs(0.3 + 0.1 * generator.standard_normal())
        if hidden == "unlisted":
            values = values + own * np.sqrt(2.0) * np.cos(2.0 * np.pi * (2 * generator.integers(1, 4))
                                                          * measurement().phase + generator.uniform(0.0, 6.0))
        elif hidden:
            values = values + own * wave(hidden)
        verdict = decide(judged(values + sd * generator.standard_normal(len(values)), sd=sd))
        wanted = {"": (Verdict.NONE, ()), "unlisted": (Verdict.UNKNOWN, ())}.get(hidden, (Verdict.NAMED, (hidden,)))
        told.append(verdict.probability)
        right.append((verdict.verdict, verdict.effects) == wanted)
    share, said = float(np.mean(right)), float(np.mean(told))
    assert abs(share - said) < 3.0 * np.sqrt(0.25 / len(right)), (share, said)


def test_a_law_that_extends_another_is_named_for_what_the_other_cannot_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """No published form of the plainer law differs by as much as that leaves, so that the wider one is nearly sure."""
    monkeypatch.setitem(SHAPES, "contact-stiffness", lambda phase, share: np.sin(2.0 * np.pi * phase))
    monkeypatch.setitem(SHAPES, "contact-stiffness-evolution",
                        lambda phase, share: (1.0 - share) * np.sin(2.0 * np.pi * phase))
    noise = SD * np.random.default_rng(7).standard_normal(LOOPS * SAMPLES)
    search = judged(cosine() + wave("contact-stiffness-evolution") + noise,
                    ("contact-stiffness", "contact-stiffness-evolution", "support-nonlinearity", "sensor-inertia"))
    verdict = decide(search)
    assert verdict.effects == ("contact-stiffness-evolution",)
    assert verdict.probability > 0.99


def test_a_law_of_another_form_may_change_levels_that_are_measured() -> None:
    """An approach that follows the test is off in single loops and smoothly over them; what is not a level is not."""
    bare = measurement()
    told, rows = replace(bare, levels=frozenset({"force"})), bare.group == 3
    signature = wave("viscous") + 5.0 * bare.cycles
    level = 5.0 * (bare.cycles - bare.cycles.mean())

    def left(own: Measurement, change: Array) -> float:
        """Return the share of a change that no form of the law makes."""
        space = np.linalg.qr(modulations(own, signature))[0]
        return float(np.linalg.norm(change - space @ (space.T @ change)) / np.linalg.norm(change))

    for change in (np.where(rows, level, 0.0), level * bare.cycles):
        assert left(told, change) < 1e-6
        assert left(bare, change) > 0.5
    assert modulations(told, signature)[:, :modulations(bare, signature).shape[1]] == pytest.approx(
        modulations(bare, signature))
