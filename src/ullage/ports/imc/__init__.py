"""IMC, the protocol of the LSTS toolchain: DUNE on board, Neptus on the ground [PintoEtAl2013]."""
