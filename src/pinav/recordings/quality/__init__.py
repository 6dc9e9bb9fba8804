"""Quality of a recording: frames, localisation, speeds, commands."""
