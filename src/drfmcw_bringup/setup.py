"""Installs drfmcw_bringup where ROS 2 looks for it."""

from glob import glob

from setuptools import find_packages, setup

NAME = 'drfmcw_bringup'

setup(
    name=NAME,
    version='0.1.0',
    packages=find_packages(exclude=['test', 'test.*']),
    package_data={NAME: ['*.xml']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + NAME]),
        ('share/' + NAME, ['package.xml']),
        ('share/' + NAME + '/launch', sorted(glob('launch/*.launch.py'))),
        ('share/' + NAME + '/config', sorted(glob('config/*.yaml'))),
        ('share/' + NAME + '/config/hardware', sorted(glob('config/hardware/*.yaml'))),
        ('share/' + NAME + '/config/tools', sorted(glob('config/tools/*'))),
        ('share/' + NAME + '/urdf', sorted(glob('urdf/*'))),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='drfmcw maintainers',
    maintainer_email='drfmcw@example.com',
    description='Launch files, parameter files and the processes of a whole graph',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'run = drfmcw_bringup.run:main',
            'demo = drfmcw_bringup.demo:main',
            'doctor = drfmcw_bringup.doctor.command:main',
        ],
    },
)
