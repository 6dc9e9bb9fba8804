"""Free kernels of rugged fields: as fine as they must be, or hills and wells."""
