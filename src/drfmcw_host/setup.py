"""Installs drfmcw_host where ROS 2 looks for it."""

from setuptools import find_packages, setup

NAME = 'drfmcw_host'

setup(
    name=NAME,
    version='0.1.0',
    packages=find_packages(exclude=['test', 'test.*']),
    package_data={NAME: ['static/*']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + NAME]),
        ('share/' + NAME, ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='drfmcw maintainers',
    maintainer_email='drfmcw@example.com',
    description='The host: configure, watch and see the stations in a browser',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'host = drfmcw_host.host:main',
        ],
    },
)
