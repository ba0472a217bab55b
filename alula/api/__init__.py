"""The functions that users call, exported from `alula`; the commands of the same names call them.

Every function takes logs and vehicles as files or as what another function returned, in SI units. Positions are in the
world frame (east, north, up); the body frame is forward, left, up; attitudes are quaternions from body to world, w
first. What a user can cause is raised as an `alula.AlulaError`: RequestError for a request that makes no sense,
DataError for data that cannot answer, VehicleError for a vehicle or a link that refuses.
"""
