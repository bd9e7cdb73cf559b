"""How far each attack must go before the mark breaks, and what odd inputs do (suite 2).

Start at `study`; `sweeps` says what is swept, `sameness` holds that one question has one answer on any machine.
"""
