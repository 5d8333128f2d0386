"""Installs drfmcw_import where ROS 2 looks for it."""

from setuptools import find_packages, setup

NAME = 'drfmcw_import'

setup(
    name=NAME,
    version='0.1.0',
    packages=find_packages(exclude=['test', 'test.*']),
    package_data={NAME + '.look': ['templates/*.html']},
    data_files=[
        ('share/ament_index/resource_index/packages', ['resource/' + NAME]),
        ('share/' + NAME, ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=True,
    maintainer='drfmcw maintainers',
    maintainer_email='drfmcw@example.com',
    description="Turns other radars' files into recordings and shows what is in a recording",
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'import = drfmcw_import.importing:main',
            'export = drfmcw_import.exporting:main',
            'view = drfmcw_import.viewing:main',
        ],
    },
)
