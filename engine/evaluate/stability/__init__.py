"""How far each attack must go before the mark breaks, and what odd inputs do (suite 2)."""
