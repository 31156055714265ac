"""What other programs read: MuJoCo's MJCF, URDF, and a log with its predictions as Parquet."""
