"""Installs drfmcw_ros where ROS 2 looks for it."""

from glob import glob

from setuptools import find_packages, setup

NAME = 'drfmcw_ros'

setup(
    name=NAME,
    version='0.1.0',
    packages=find_packages(exclude=['test', 'test.*']),
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + NAME]),
        ('share/' + NAME, ['package.xml']),
        ('share/' + NAME + '/systemd', sorted(glob('systemd/*.service'))),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=True,
    maintainer='drfmcw maintainers',
    maintainer_email='drfmcw@example.com',
    description='Plumbing that every node of drfmcw shares',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'record = drfmcw_ros.bag.record:main',
            'info = drfmcw_ros.bag.info:main',
            'repair = drfmcw_ros.bag.repair:main',
            'keystore = drfmcw_ros.operation.keystore:main',
        ],
    },
)
