import numpy as np
import torch

from irl_dal.evaluation.agents import ExpertAgent, PolicyAgent, RandomAgent
from tests.irl_dal.evaluation.small import small_rig
from tests.irl_dal.learning.samples import new_policy, observation


def test_the_policys_answer_is_what_stable_baselines3_predicts() -> None:
    """The mean action, clipped to the action space, bit by bit."""
    policy, rng = new_policy(), np.random.default_rng(0)
    with torch.no_grad():
        policy.action_net.weight *= 300.0  # so that some answers are clipped
    agent, answers = PolicyAgent(policy), []
    for _ in range(20):
        seen = observation(rng)
        answers.append(agent.act(seen, {}))
        predicted, _ = policy.predict(seen, deterministic=True)
        np.testing.assert_array_equal(answers[-1], predicted)
    clipped = np.abs(answers) == 1.0
    assert clipped.any() and not clipped.all()


def test_random_actions_repeat_with_the_seed() -> None:
    """The same seed draws the same actions, another one others; all in the action space."""
    agent, drawn = RandomAgent(), []
    for seed in (1, 1, 2):
        agent.reset(seed)
        drawn.append(np.array([agent.act({}, {}) for _ in range(50)]))
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert (drawn[0] != drawn[2]).any()
    assert np.abs(drawn[0]).max() <= 1.0


def test_the_expert_answers_with_its_label_and_drives_to_it() -> None:
    """What is compared is the set-point, what is executed what the follower makes of it."""
    rig = small_rig("expert")
    try:
        observation, info = rig.loop.reset(seed=1)
        agent = ExpertAgent()
        action = agent.act(observation, info)
        np.testing.assert_array_equal(action, info["expert_action"])
        command = rig.loop.follow(info["expert"].setpoint)
        after = agent.drive(rig.loop, action)[-1]
        np.testing.assert_array_equal(after["nominal_command"], command)
    finally:
        rig.close()
