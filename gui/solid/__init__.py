"""The instrument in three dimensions: rendered by PyVista in a process of its own, shown as pictures by the window.

What holds the Qt thread up (loading VTK, a first picture, a software renderer), or ends a process without a word (no
OpenGL), happens over there.
"""

#: In the environment: ``solid`` renders whatever Qt draws on, ``lines`` never; otherwise wherever there is a screen.
VARIABLE = "GONIOTWIN_3D"
