"""Episodes that follow one another, as training plays them."""

import numpy as np
import torch

from bci_app.gridworld import compile_map
from policy.episodes import Episodes, drawn
from policy.simulator import pair_weights
from policy.verdicts import Stock, Verdicts, anybody

RING = compile_map("....\n.##.\n.##.\n....", "ring")


def some(n=20, seed=0, limit=12, draw=anybody, believes=True):
    return Episodes(RING, n, pair_weights(RING, "pairs"), draw, np.random.default_rng(seed), limit, believes)


def random_moves(episodes, n_steps, rng):
    for _ in range(n_steps):
        legal = RING.legal[episodes.simulator.cell]
        action = np.array([rng.choice(np.flatnonzero(row)) for row in legal])
        outcome = episodes.move(action)
        yield outcome
        episodes.renew(outcome.done)


def test_episodes_that_end_begin_anew_from_fresh_pairs_with_fresh_decoders():
    episodes, ended = some(), 0
    for outcome in random_moves(episodes, 60, np.random.default_rng(1)):
        ended += int(outcome.done.sum())
        # The last one's book-keeping is still there until it is renewed.
        assert (episodes.simulator.step_number <= 12).all()
        assert (episodes.simulator.cell == episodes.simulator.goal)[outcome.terminated].all()
    assert ended > 60
    distance = RING.distance[episodes.simulator.start, episodes.simulator.goal]
    assert (distance >= 2).all()
    assert len(set(episodes.simulator.decoders.information.tolist())) > 10


def test_the_same_seed_gives_the_same_episodes():
    runs = [some(seed=seed) for seed in (3, 3, 4)]
    for outcomes in zip(*(random_moves(run, 40, np.random.default_rng(1)) for run in runs[:2]), strict=True):
        np.testing.assert_array_equal(outcomes[0].done, outcomes[1].done)
    np.testing.assert_array_equal(runs[0].belief.probability, runs[1].belief.probability)
    assert not np.array_equal(runs[0].simulator.start, runs[2].simulator.start)


def test_without_a_belief_it_stays_at_the_prior_and_the_episodes_are_the_same():
    draw = Verdicts("binary", (0.9,))
    believing, plain = some(draw=draw), some(draw=draw, believes=False)
    prior = plain.belief.probability.copy()
    walks = (random_moves(one, 30, np.random.default_rng(1)) for one in (believing, plain))
    for outcomes in zip(*walks, strict=True):
        np.testing.assert_array_equal(outcomes[0].done, outcomes[1].done)
    np.testing.assert_array_equal(plain.belief.probability, prior)
    assert not np.array_equal(believing.belief.probability, prior)


def test_legal_actions_are_the_worlds():
    episodes = some()
    np.testing.assert_array_equal(episodes.legal().numpy(), RING.legal[episodes.simulator.cell])


def test_actions_are_drawn_with_their_probabilities():
    probabilities = torch.tensor([0.5, 0.0, 0.15, 0.35])
    actions = drawn(probabilities.log().expand(50_000, 4), np.random.default_rng(0))
    np.testing.assert_allclose(np.bincount(actions, minlength=4) / 50_000, probabilities, atol=0.01)
    again = drawn(probabilities.log().expand(50_000, 4), np.random.default_rng(0))
    assert torch.equal(actions, again)


def test_a_stock_of_decoders_hands_out_what_was_drawn_once_each():
    drawn_at, rng = [], np.random.default_rng(0)

    def draw(n, rng):
        drawn_at.append(n)
        return anybody(n, rng)

    stock, taken = Stock(draw), []
    for n in [30] * 200:
        taken.append(stock(n, rng).information)
        assert len(taken[-1]) == n
    assert drawn_at == [Stock.SIZE, Stock.SIZE]  # 6000 decoders
    information = np.concatenate(taken)
    telling = information[information > 0]  # dead decoders are all alike
    assert len(telling) > 0.9 * len(information)
    assert len(np.unique(telling)) > 0.98 * len(telling)
    many = stock(2 * Stock.SIZE, rng)
    assert len(many.information) == 2 * Stock.SIZE
