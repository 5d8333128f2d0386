"""Installs drfmcw_gateway where ROS 2 looks for it."""

from setuptools import find_packages, setup

NAME = 'drfmcw_gateway'

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
    description='Ranges for crane controllers (OPC UA, Modbus TCP, an example subscriber), and the graph for Foxglove',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'foxglove_bridge = drfmcw_gateway.foxglove_bridge:main',
            'follow_range = drfmcw_gateway.follow_range:main',
            'gateway = drfmcw_gateway.gateway:main',
        ],
    },
)
