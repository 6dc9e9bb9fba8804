"""Exact solutions of the bioheat equation, as functions of their parameters."""

from validation.heat.exact.gaussians import gaussian_source as gaussian_source
from validation.heat.exact.gaussians import periodic_box as periodic_box
from validation.heat.exact.lumped import lumped_forced as lumped_forced
from validation.heat.exact.lumped import lumped_nonlinear as lumped_nonlinear
from validation.heat.exact.lumped import lumped_rise as lumped_rise
from validation.heat.exact.lumped import ramp_dose as ramp_dose
from validation.heat.exact.media import SET_S as SET_S
from validation.heat.exact.media import Medium as Medium
from validation.heat.exact.slabs import perfused_ball as perfused_ball
from validation.heat.exact.slabs import perfused_cylinder as perfused_cylinder
from validation.heat.exact.slabs import perfused_slab as perfused_slab
from validation.heat.exact.slabs import skin as skin
from validation.heat.exact.spheres import heated_sphere as heated_sphere
from validation.heat.exact.spheres import heated_sphere_kernels as heated_sphere_kernels
from validation.heat.exact.spheres import (
    heated_sphere_sensitivities as heated_sphere_sensitivities,
)
from validation.heat.exact.spheres import perfused_spheres as perfused_spheres
from validation.heat.exact.spheres import point_source as point_source
from validation.heat.exact.spheres import two_conductivities as two_conductivities
