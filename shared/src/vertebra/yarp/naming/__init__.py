"""Who is where: the name server's clients, its table, and how it is found."""
