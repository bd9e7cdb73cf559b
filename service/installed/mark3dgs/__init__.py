"""Mark3DGS as its users import it: `mark3dgs.client` talks to a service."""
