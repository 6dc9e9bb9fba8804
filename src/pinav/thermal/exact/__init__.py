"""Exact solutions of the bioheat equation, as functions of their parameters."""

from pinav.thermal.exact.gaussians import gaussian_decay as gaussian_decay
from pinav.thermal.exact.gaussians import gaussian_source as gaussian_source
from pinav.thermal.exact.gaussians import periodic_box as periodic_box
from pinav.thermal.exact.lumped import least_energy as least_energy
from pinav.thermal.exact.lumped import least_energy_control as least_energy_control
from pinav.thermal.exact.lumped import lumped_by_perfusion as lumped_by_perfusion
from pinav.thermal.exact.lumped import lumped_forced as lumped_forced
from pinav.thermal.exact.lumped import lumped_nonlinear as lumped_nonlinear
from pinav.thermal.exact.lumped import lumped_rise as lumped_rise
from pinav.thermal.exact.lumped import on_off_cycle as on_off_cycle
from pinav.thermal.exact.lumped import ramp_dose as ramp_dose
from pinav.thermal.exact.lumped import saturate_and_ride as saturate_and_ride
from pinav.thermal.exact.media import SET_S as SET_S
from pinav.thermal.exact.media import Medium as Medium
from pinav.thermal.exact.slabs import discrete_eigenmode_rate as discrete_eigenmode_rate
from pinav.thermal.exact.slabs import eigenmode_rate as eigenmode_rate
from pinav.thermal.exact.slabs import perfused_ball as perfused_ball
from pinav.thermal.exact.slabs import perfused_cylinder as perfused_cylinder
from pinav.thermal.exact.slabs import perfused_slab as perfused_slab
from pinav.thermal.exact.slabs import perfused_slab_flux as perfused_slab_flux
from pinav.thermal.exact.slabs import (
    perfused_slab_sensitivities as perfused_slab_sensitivities,
)
from pinav.thermal.exact.slabs import skin as skin
from pinav.thermal.exact.spheres import heated_sphere as heated_sphere
from pinav.thermal.exact.spheres import heated_sphere_by_rate as heated_sphere_by_rate
from pinav.thermal.exact.spheres import heated_sphere_kernels as heated_sphere_kernels
from pinav.thermal.exact.spheres import (
    heated_sphere_sensitivities as heated_sphere_sensitivities,
)
from pinav.thermal.exact.spheres import perfused_spheres as perfused_spheres
from pinav.thermal.exact.spheres import point_source as point_source
from pinav.thermal.exact.spheres import two_conductivities as two_conductivities
