"""Exact solutions of the bioheat equation, as functions of their parameters."""

from pinav.thermal.exact.gaussians import gaussian_decay as gaussian_decay
from pinav.thermal.exact.gaussians import gaussian_source as gaussian_source
from pinav.thermal.exact.gaussians import periodic_box as periodic_box
from pinav.thermal.exact.lumped import lumped_forced as lumped_forced
from pinav.thermal.exact.lumped import lumped_nonlinear as lumped_nonlinear
from pinav.thermal.exact.lumped import lumped_rise as lumped_rise
from pinav.thermal.exact.lumped import ramp_dose as ramp_dose
from pinav.thermal.exact.media import SET_S as SET_S
from pinav.thermal.exact.media import Medium as Medium
from pinav.thermal.exact.slabs import perfused_ball as perfused_ball
from pinav.thermal.exact.slabs import perfused_cylinder as perfused_cylinder
from pinav.thermal.exact.slabs import perfused_slab as perfused_slab
from pinav.thermal.exact.slabs import skin as skin
from pinav.thermal.exact.spheres import heated_sphere as heated_sphere
from pinav.thermal.exact.spheres import heated_sphere_kernels as heated_sphere_kernels
from pinav.thermal.exact.spheres import (
    heated_sphere_sensitivities as heated_sphere_sensitivities,
)
from pinav.thermal.exact.spheres import perfused_spheres as perfused_spheres
from pinav.thermal.exact.spheres import point_source as point_source
from pinav.thermal.exact.spheres import two_conductivities as two_conductivities
