"""Environment of all tests: messages check their fields, and what a test starts talks to nobody but itself."""

import os

from drfmcw_bringup.graph import free_domain_id

os.environ.setdefault('ROS_PYTHON_CHECK_FIELDS', '1')
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ['ROS_DOMAIN_ID'] = str(free_domain_id())
