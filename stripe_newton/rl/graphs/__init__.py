# SPDX-License-Identifier: Apache-2.0
"""Training in CUDA graphs: recorded programs, PPO's update, the rollout, and the loop that launches them."""
