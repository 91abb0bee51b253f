"""A policy without learning: the pan oscillates, one axis is soft; `write_checkpoint` saves it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from lerobot.configs.policies import PreTrainedConfig
from lerobot.configs.types import FeatureType, PolicyFeature
from lerobot.optim.optimizers import AdamConfig
from lerobot.policies.pretrained import PreTrainedPolicy
from lerobot.processor import (
    AddBatchDimensionProcessorStep,
    DeviceProcessorStep,
    PolicyProcessorPipeline,
    RenameObservationsProcessorStep,
)
from lerobot.utils.constants import POLICY_POSTPROCESSOR_DEFAULT_NAME as POST
from lerobot.utils.constants import POLICY_PREPROCESSOR_DEFAULT_NAME as PRE
from torch import Tensor, nn

#: Period of the oscillation [steps].
PERIOD = 60
#: Amplitude of the oscillation [°].
AMPLITUDE = 15.0


@PreTrainedConfig.register_subclass("sway")
@dataclass
class SwayConfig(PreTrainedConfig):
    """Sizes of observation and action, and the force that the policy commands.

    Attributes:
        n_states, n_actions: Number of observed and of commanded values.
        force: Force in the last entry of the action [N]; 0: the last entry is a motor.
    """

    n_states: int = 6
    n_actions: int = 6
    force: float = 0.0

    observation_delta_indices = None
    action_delta_indices = None
    reward_delta_indices = None

    def get_optimizer_preset(self) -> AdamConfig:
        return AdamConfig(lr=1e-3)

    def get_scheduler_preset(self) -> None:
        return None

    def validate_features(self) -> None:
        pass


class SwayPolicy(PreTrainedPolicy):
    """Moves the first motor along a sine and commands `force`; all other motors go to 0."""

    config_class = SwayConfig
    name = "sway"

    def __init__(self, config: SwayConfig, **_: Any) -> None:
        super().__init__(config)
        self.unused = nn.Parameter(torch.zeros(1))
        self.count = 0

    def get_optim_params(self) -> Any:
        return self.parameters()

    def reset(self) -> None:
        self.count = 0

    def forward(self, batch: dict[str, Tensor]) -> Any:
        raise NotImplementedError

    def predict_action_chunk(self, batch: dict[str, Tensor], **_: Any) -> Tensor:
        return self.select_action(batch)[:, None]

    def select_action(self, batch: dict[str, Tensor], **_: Any) -> Tensor:
        state = batch["observation.state"]
        if state.shape[-1] != self.config.n_states:
            raise ValueError(f"{state.shape[-1]} states, not {self.config.n_states}")
        action = torch.zeros(1, self.config.n_actions)
        action[0, 0] = AMPLITUDE * math.sin(2.0 * math.pi * self.count / PERIOD)
        if self.config.force:
            action[0, -1] = self.config.force
        self.count += 1
        return action


def write_checkpoint(
    folder: Path, states: Sequence[str], actions: Sequence[str], force: float
) -> None:
    """Write a checkpoint as `lerobot-train` does."""
    config = SwayConfig(
        n_states=len(states),
        n_actions=len(actions),
        force=force,
        device="cpu",
        input_features={
            "observation.state": PolicyFeature(type=FeatureType.STATE, shape=(len(states),))
        },
        output_features={"action": PolicyFeature(type=FeatureType.ACTION, shape=(len(actions),))},
    )
    SwayPolicy(config).save_pretrained(folder)
    PolicyProcessorPipeline(
        steps=[
            RenameObservationsProcessorStep(rename_map={}),
            AddBatchDimensionProcessorStep(),
            DeviceProcessorStep(device="cpu"),
        ],
        name=PRE,
    ).save_pretrained(folder)
    PolicyProcessorPipeline(steps=[DeviceProcessorStep(device="cpu")], name=POST).save_pretrained(
        folder
    )
