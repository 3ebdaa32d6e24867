# SPDX-License-Identifier: Apache-2.0
"""Sensors: structs with the measurements that terms read, and the kernels that fill them; one file a kind of sensor."""
