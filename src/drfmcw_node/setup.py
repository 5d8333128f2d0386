"""Installs drfmcw_node where ROS 2 looks for it."""

from setuptools import find_packages, setup

NAME = 'drfmcw_node'

setup(
    name=NAME,
    version='0.1.0',
    packages=find_packages(exclude=['test', 'test.*']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + NAME]),
        ('share/' + NAME, ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=True,
    maintainer='drfmcw maintainers',
    maintainer_email='drfmcw@example.com',
    description='One sensor-node of the radar: from IF samples to beat frequencies',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'station = drfmcw_node.station:main',
            'pair_station = drfmcw_node.pair_station:main',
            'send_sweeps = drfmcw_node.send_sweeps:main',
        ],
    },
)
