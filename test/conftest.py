"""Environment of all tests: messages check their fields, and what a test starts talks to nobody but itself."""

import os
import signal

from drfmcw_bringup.graph import free_domain_id

os.environ.setdefault('ROS_PYTHON_CHECK_FIELDS', '1')
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ['ROS_DOMAIN_ID'] = str(free_domain_id())

# started in the background (nohup, some CI services) we would pass an ignored Ctrl-C on to the processes under test
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
