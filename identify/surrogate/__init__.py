"""A model of the admittance over operating points, Y(f; P, Q, V), that states how sure it is."""
