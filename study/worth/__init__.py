"""Worth: what further rollouts are worth to the policy that is trained after them (`python -m study.worth`).

posterior                what is known of the parameters: a normal distribution within their bounds
decision                 what a policy made for some parameters returns on a machine of others
value_of_information     acting now, after further rollouts, and with perfect knowledge
figure                   the answer's picture
"""
