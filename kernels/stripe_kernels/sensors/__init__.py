# SPDX-License-Identifier: Apache-2.0
"""What sensors measure, as structs that terms read, and the kernels that fill them: a file for each kind of sensor."""
