"""Installs drfmcw_fusion where ROS 2 looks for it."""

from setuptools import find_packages, setup

NAME = 'drfmcw_fusion'

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
    description='From the beat frequencies of two stations to their distance',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'frames = drfmcw_fusion.crane.frames:main',
            'fusion = drfmcw_fusion.fusion:main',
            'replay = drfmcw_fusion.replay:main',
        ],
    },
)
