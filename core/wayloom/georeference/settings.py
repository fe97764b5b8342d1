"""Settings of the geo-reference. The noise model is explained in `wayloom.mapping.drive_graph`."""

from pydantic import Field

from wayloom.config.settings import Settings


class GeoReferenceSettings(Settings):
    """Noise models of odometry, GNSS and gravity, and outlier gates."""

    position_noise_m: float = Field(
        0.005, gt=0.0, le=5.0, description="odometry: sigma of position after one metre at true scale, m; grows with the root"
    )
    rotation_noise_deg: float = Field(0.02, gt=0.0, le=10.0, description="odometry: sigma of rotation after one metre, degrees")
    standing_position_m: float = Field(
        0.002, gt=0.0, le=1.0, description="odometry: sigma of position between nodes at one place, m"
    )
    standing_rotation_deg: float = Field(
        0.01, gt=0.0, le=5.0, description="odometry: sigma of rotation between nodes at one place, degrees"
    )
    window_factor: float = Field(
        3.0,
        ge=0.0,
        le=1000.0,
        description="odometry: times its window's covariance, which counts where it is more than the noise above; 0: not used",
    )
    scale_sigma: float = Field(0.02, gt=0.0, le=0.5, description="odometry: sigma of its scale, as a share; it varies slowly")
    local_scale_sigma: float = Field(
        0.002, gt=0.0, le=0.5, description="odometry: what its scale wanders by from street to street, of a rig that is known well"
    )
    scale_length_m: float = Field(
        100.0, gt=0.0, le=1e5, description="road over which the odometry's scale becomes another, m (correlation 1/e)"
    )
    level_sigma_deg: float = Field(3.0, gt=0.0, le=45.0, description="how level the camera is, sigma of roll and pitch, degrees")
    level_every_m: float = Field(500.0, gt=0.0, description="one level prior each such stretch of road, m")
    accelerometer_lean_deg: float = Field(
        0.5, gt=0.0, le=10.0, description="accelerometer: how far it may be off as a whole, bias and mounting, degrees"
    )
    accelerometer_floor_deg: float = Field(0.1, gt=0.0, le=10.0, description="accelerometer: sigma of up over 4 s at best, degrees")
    uprights_lean_deg: float = Field(0.15, gt=0.0, le=10.0, description="walls and poles: how far all may lean sideways, degrees")
    uprights_pitch_deg: float = Field(
        1.5,
        gt=0.0,
        le=10.0,
        description="walls and poles: how far all may lean along the view, where depths err with the row, degrees",
    )
    street_lean_deg: float = Field(1.0, gt=0.0, le=10.0, description="streets: cross fall on the side that is driven, degrees")
    gnss_correlation_s: float = Field(20.0, gt=0.0, le=3600.0, description="time after which GNSS errors are independent, s")
    gnss_white_share: float = Field(
        0.5, gt=0.0, lt=1.0, description="share of a fix's sigma that is independent from fix to fix, where too few fixes tell"
    )
    height_datum_sigma_m: float = Field(
        0.0,
        ge=0.0,
        le=200.0,
        description="by how much the heights of all fixes may be off together (datum, geoid), sigma, m; no drive can tell that",
    )
    max_fix_rate_hz: float = Field(10.0, gt=0.0, le=1000.0, description="fixes that come faster are thinned to this rate, Hz")
    sigma_floor_m: float = Field(0.01, gt=0.0, le=1.0, description="no fix is trusted beyond this: lever arm and clock, m")
    gate_probability: float = Field(
        0.9999, gt=0.9, lt=1.0, description="a fix is an outlier beyond this quantile of chi-square (3)"
    )
    gate_floor_m: float = Field(
        0.02, ge=0.0, le=5.0, description="added to a fix's sigma when it is judged, never when it is used, m"
    )
    time_offset_sigma_s: float = Field(
        0.05,
        gt=0.0,
        le=10.0,
        description="prior sigma of the receiver's clock against the cameras', s; 0.0002 where a pulse triggers both",
    )
    lever_sigma_m: float = Field(0.002, gt=0.0, le=10.0, description="prior sigma of a given lever arm, m, each axis")
    unknown_lever_sigma_m: float = Field(
        1.5, gt=0.0, le=20.0, description="prior sigma of a lever arm that is not given, m, each axis"
    )
    ransac_threshold_sigma: float = Field(4.0, gt=0.5, le=20.0, description="first alignment: inliers within so many sigma")
    ransac_rounds: int = Field(200, ge=10, le=10_000)
    min_baseline_m: float = Field(5.0, gt=0.0, description="heading is called observed from this extent of the track, m")
    node_spacing_m: float = Field(
        0.5, gt=0.0, le=100.0, description="a frame becomes a node of the graph at the latest after so far, m"
    )
